"""Sequences of scenes: frames on disk, one file of all of them, and what frames share."""
