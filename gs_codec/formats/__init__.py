"""Foreign formats: PLY, compressed PLY, `.splat`, `.spz`, SOG."""
