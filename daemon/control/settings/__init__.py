"""The settings of a running daemon: which there are, which can change live, and how they change together."""
