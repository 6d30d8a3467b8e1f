"""Commands for takes on disk."""
