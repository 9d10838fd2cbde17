"""Views of a scene: its cameras found or estimated, photographs, pictures of views."""
