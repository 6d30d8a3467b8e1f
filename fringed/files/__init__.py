"""Clouds in files: the store of reprocessed takes, PCD and PLY."""
