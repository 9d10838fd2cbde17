"""Tools that codecs share: entropy coders, frequency tables, orders and neighbours."""
