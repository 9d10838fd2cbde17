"""Why coding works on a scene, and where it does not (paper, Section 3): numbers, plots, report."""
