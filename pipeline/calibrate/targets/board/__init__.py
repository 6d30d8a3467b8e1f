"""Boards: which there are, and what is printed on them."""
