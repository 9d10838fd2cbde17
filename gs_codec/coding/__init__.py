"""Tools that codecs share: entropy coders, frequency tables, Morton order, neighbour search."""
