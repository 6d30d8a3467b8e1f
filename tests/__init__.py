"""Tests; this module is imported before all others of theirs, and before anything imports numpy."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program itself has it (daemon.cli.allocator)
