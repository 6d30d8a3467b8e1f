"""The settings of a running daemon: their catalogue, which of them can change live, and their changes."""
