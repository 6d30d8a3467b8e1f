"""How a service manager sees the daemon: notifications, proof of life, journal, signals."""
