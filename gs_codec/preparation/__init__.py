"""Make a scene smaller before it is coded: prune it, then optimise the remaining Gaussians."""
