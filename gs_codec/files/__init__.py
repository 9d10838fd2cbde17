"""The public functions that work from file to file."""
