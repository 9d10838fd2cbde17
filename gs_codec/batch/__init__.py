"""Folders of scenes, here or elsewhere: what to encode, where it runs, and the report of it."""
