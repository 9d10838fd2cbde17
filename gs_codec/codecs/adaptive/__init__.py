"""Profiles ``l``, ``m`` and ``s``: individual step sizes for each attribute of each Gaussian."""
