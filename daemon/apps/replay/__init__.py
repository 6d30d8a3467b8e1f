"""Replay: the clouds of a take, their timing, and their comparison with a golden file."""
