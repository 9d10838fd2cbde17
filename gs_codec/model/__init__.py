"""Distributions of quantised symbols, as integer frequency tables any machine derives alike."""
