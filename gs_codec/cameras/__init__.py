"""Cameras: pinhole cameras and lenses, and readers of other programs' camera files."""
