"""Entropy coders: static interleaved rANS, adaptive binary coder."""
