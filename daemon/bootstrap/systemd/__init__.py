"""The service manager's side of the daemon: notifications, watchdog, journal."""
