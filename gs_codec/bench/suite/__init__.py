"""Measure scenes with profiles and peers in one run, and report the results."""
