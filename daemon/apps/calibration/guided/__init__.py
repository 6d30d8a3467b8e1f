"""The guided session: the board is observed live and captured whenever it is still in a new pose."""
