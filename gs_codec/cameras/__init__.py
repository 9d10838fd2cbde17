"""Cameras: pinhole cameras and lenses, and the files of other programs that hold them."""
