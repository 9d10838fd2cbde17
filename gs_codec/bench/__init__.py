"""Measurements behind every number the documents state."""
