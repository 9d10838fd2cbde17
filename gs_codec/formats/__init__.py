"""Formats of scenes: `table` declares them, `registry` recognises and reads files."""
