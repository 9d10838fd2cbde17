"""`.rad` files of Spark."""
