"""Files of a wanted size or quality."""
