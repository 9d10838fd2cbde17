"""Analyse how well coding works on a scene (paper, Section 3): numbers, plots, report."""
