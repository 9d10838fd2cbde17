"""Measurements for every number in the documents."""
