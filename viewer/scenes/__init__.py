"""Scenes, cameras and choices that the viewer shows."""
