"""Makes a scene smaller before it is coded: pruning, then optimising what is left."""
