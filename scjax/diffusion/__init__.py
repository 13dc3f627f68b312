"""Diffusion and rectified flow on latents: noise schedules, training losses, guidance and samplers."""
