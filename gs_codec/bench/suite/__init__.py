"""Scenes by profiles and peers, measured in one run, and the report of it."""
