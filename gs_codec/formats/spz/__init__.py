"""`.spz` files of Niantic."""
