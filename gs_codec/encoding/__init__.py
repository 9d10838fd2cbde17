"""Encode a scene: the order of stages; measuring the loss, and retrying with finer steps."""
