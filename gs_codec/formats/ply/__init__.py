"""PLY files: the INRIA layout, its dialects, and PlayCanvas's packed properties."""
