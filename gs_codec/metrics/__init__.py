"""Errors of attributes and of images."""
