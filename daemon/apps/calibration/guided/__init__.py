"""The guided session: the board is looked at live, and captured by itself whenever it is held still at a new pose."""
