"""Edit scenes: select, move, merge, clean, decimate, describe."""
