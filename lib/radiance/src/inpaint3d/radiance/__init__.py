"""Radiance fields: rays, sampling, fields, volume rendering, losses."""
