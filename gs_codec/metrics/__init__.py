"""What was lost: errors of attributes, and of images."""
