"""Health for Prometheus: the metrics and the HTTP server that exposes them."""
