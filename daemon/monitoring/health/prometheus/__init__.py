"""Health for Prometheus: the text, and the HTTP server that gives it."""
