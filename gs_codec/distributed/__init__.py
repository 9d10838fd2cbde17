"""Encode and decode one giant scene with several processes or machines."""
