"""Gaussians in OpenUSD."""
