"""Quantisation on lattices whose steps follow how much of each Gaussian is seen."""
