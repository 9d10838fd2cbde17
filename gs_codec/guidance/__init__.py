"""Guidance for the encoder: sensitivities to step sizes, colours, and camera-free calibration."""
