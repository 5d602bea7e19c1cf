"""Comparisons of the model with the source paper, published tests and a second method; not in the installed package."""
