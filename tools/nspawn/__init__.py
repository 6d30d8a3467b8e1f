"""A real systemd in a container that leaves this machine as it is: what the service's tests and benchmark run in."""

from tools.nspawn.machine import Machine, MachineError, missing

__all__ = ["Machine", "MachineError", "missing"]
