"""Scenes of XGRIDS: `.lcc` and `.lcc2`."""
