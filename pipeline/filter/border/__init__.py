"""Points at the border of a surface: those that are probably wrong are rejected, the others get the sigma they have."""
