"""Profile ``lossless``: every float bit-exact."""
