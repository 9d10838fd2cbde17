"""Profiles ``paper-*``: EntropyGS as published (arXiv 2508.10227)."""
