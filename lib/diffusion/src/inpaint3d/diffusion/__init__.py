"""Diffusion inpainting priors: schedules, denoisers, samplers, distillation."""
