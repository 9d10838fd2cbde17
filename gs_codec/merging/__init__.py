"""Several Gaussians merged into one: covariances, pairs, rounds of merging."""
