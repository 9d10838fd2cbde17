"""One giant scene, encoded and decoded by several processes or machines."""
