"""Contents of the viewer, as points, cubes and pictures drawn in software."""
