"""Metrics by named protocols, pictures and a report."""
