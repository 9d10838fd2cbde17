"""Batches: encode folders of scenes, on this machine or a cluster, and report each scene."""
