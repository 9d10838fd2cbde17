"""The `.egs` file: header, section table, checksums. FORMAT.md is the normative text."""
