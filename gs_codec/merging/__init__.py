"""Merge several Gaussians into one: covariances, pairs, rounds of merging."""
