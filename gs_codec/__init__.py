"""Entropy coding of 3D Gaussian Splatting scenes (EntropyGS, arXiv 2508.10227)."""

__version__ = "0.1.0"
