"""Comparisons of the model with the source paper and published tests, and of its two numerical methods with each other.

The installed package does not contain them.
"""
