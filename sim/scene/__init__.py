"""Scenes: shapes, textures, and where rays meet them."""
