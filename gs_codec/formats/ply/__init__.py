"""PLY files: the INRIA layout, its dialects, and PlayCanvas' packed properties."""
