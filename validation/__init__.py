"""Compares the model with the source paper, published tests and a second route. Not part of the installed package."""
