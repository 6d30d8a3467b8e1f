"""A real systemd in a container, for the service's tests and benchmark; the machine itself is not changed."""

from tools.nspawn.machine import Machine, MachineError, missing

__all__ = ["Machine", "MachineError", "missing"]
