"""Takes written: queue, parts, disk space, and numbers without gaps."""
