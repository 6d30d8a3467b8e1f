"""The last hours as a picture, drawn alike as SVG (for a page) and PNG. Loaded by commands, never by the daemon."""
