"""Encode a scene: the order of the stages; the loss in rendered views, and finer steps if high."""
