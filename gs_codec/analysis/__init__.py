"""Analyse why coding works on a scene, and where not (paper, Section 3): numbers, plots, report."""
