"""Checks of the machine: clock, disk, memory, processors, sockets, service, files."""
