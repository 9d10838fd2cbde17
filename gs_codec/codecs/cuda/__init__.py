"""Profiles ``l``, ``m`` and ``s`` decoded on a CUDA device, with the numbers of the CPU's decoder."""
