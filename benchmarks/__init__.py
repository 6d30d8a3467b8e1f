"""Accuracy against the simulator's truth, and speed."""
