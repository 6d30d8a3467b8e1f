"""The X display by ctypes: connection, outputs, modes, gamma tables, vertical blanks."""
