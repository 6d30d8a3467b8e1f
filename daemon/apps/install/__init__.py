"""Installation of the daemon as a service, and its removal."""
