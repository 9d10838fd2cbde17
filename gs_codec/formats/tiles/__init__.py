"""Gaussians in 3D Tiles 1.1, as CesiumJS shows them."""
