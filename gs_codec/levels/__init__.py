"""Coarser levels of detail of a file: merged Gaussians, their errors, the sections."""
