"""Cameras, and images of a scene as the 3DGS rasteriser draws them."""
