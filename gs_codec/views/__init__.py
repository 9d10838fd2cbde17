"""Views of a scene: find or estimate its cameras, read photographs, render to files."""
