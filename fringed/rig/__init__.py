"""One interface for a running daemon and for recordings: clouds, previews, settings, status, takes."""
