"""Functions from files to files."""
