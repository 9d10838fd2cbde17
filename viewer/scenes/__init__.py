"""Scenes, cameras and the user's choices."""
