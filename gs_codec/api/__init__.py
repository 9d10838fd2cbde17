"""Functions on Open3D point clouds."""
