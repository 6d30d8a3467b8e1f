"""Put the daemon onto a machine as a service, and take it away again."""
