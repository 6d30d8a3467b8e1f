"""Replay: the clouds of a take, their timing, and whether they are still what they were."""
