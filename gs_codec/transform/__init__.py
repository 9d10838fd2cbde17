"""Reordering of data without loss: interleaved to planar, Morton order."""
