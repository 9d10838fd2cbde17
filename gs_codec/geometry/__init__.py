"""Geometry and SH-DC as a coloured point cloud."""
