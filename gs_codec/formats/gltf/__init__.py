"""Gaussians in glTF 2.0."""
