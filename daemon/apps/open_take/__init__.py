"""Takes behind ``fringed.open``: the entry point ``fringed.readers``."""
