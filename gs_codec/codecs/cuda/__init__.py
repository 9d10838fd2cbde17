"""Profiles ``l``, ``m``, ``s`` decoded on a CUDA device, to the numbers of the CPU's decoder."""
