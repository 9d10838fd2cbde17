"""The container of `.egs` files: header, sections, checksums."""
