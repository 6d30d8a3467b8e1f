"""Tests; this module is imported before all others of theirs, and before anything imports numpy."""

import os
import sys

if "numpy" in sys.modules and "OPENBLAS_NUM_THREADS" not in os.environ:
    # Its threads would wait for each other: on busy processors the small matrices of the tests take four times as long.
    raise RuntimeError("numpy was imported before the tests, by a plugin: leave it out as those in pyproject.toml")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program itself has it (daemon.cli.allocator)
