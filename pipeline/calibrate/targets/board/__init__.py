"""Boards: their kinds, marks and drawings."""
