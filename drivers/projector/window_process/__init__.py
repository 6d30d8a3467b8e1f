"""The process that owns the projector's window, and its supervision by the driver."""
