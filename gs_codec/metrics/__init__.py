"""Errors of attributes and images."""
