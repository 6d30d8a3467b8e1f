"""Health reports as text, HTML page (SVG) and PNG. Imported by commands, never by the daemon."""
