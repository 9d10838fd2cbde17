"""Entropy coders: static interleaved rANS, adaptive binary coder, torchac as reference."""
