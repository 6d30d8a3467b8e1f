"""Simulated devices that implement the drivers' protocols: options, faults, triggers."""
