"""Render scenes like the 3DGS rasteriser, and differentiate renders."""
