"""Decode profiles ``l``, ``m`` and ``s`` on a CUDA device, bit-identical to the CPU's decoder."""
