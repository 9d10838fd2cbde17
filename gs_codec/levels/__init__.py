"""Coarser levels of detail of a file: merged Gaussians, block errors, sections."""
