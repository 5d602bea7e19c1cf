"""Comparisons of the model with the source paper, published tests and a second route; not in the installed package."""
