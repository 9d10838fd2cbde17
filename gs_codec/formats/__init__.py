"""Formats of other programs: PLY, compressed PLY, `.splat`, `.spz`, SOG, glTF, USD, checkpoints."""
