"""Shared by all stages: errors, settings, compilation, arithmetic on tiles, stopwatch."""
