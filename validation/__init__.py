"""Comparisons of the model with a second route to the same answers. Not part of the installed package."""
