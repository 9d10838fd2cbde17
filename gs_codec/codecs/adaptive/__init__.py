"""Profiles ``l``, ``m`` and ``s``: a step size for each attribute of each Gaussian."""
