"""Commands for a running daemon."""
