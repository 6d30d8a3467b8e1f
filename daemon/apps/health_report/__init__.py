"""The last hours as an image, drawn alike as SVG (for a page) and PNG. Loaded by commands, never by the daemon."""
