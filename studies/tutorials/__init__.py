"""Tutorials: one script in cells for each main question; open them in a notebook or run them as they are."""
