"""Reprocessing: the clouds of many recordings, computed by many processes, bit for bit those of a replay."""
