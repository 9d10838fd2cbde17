"""What the viewer shows, as points, cubes and pictures drawn in software."""
