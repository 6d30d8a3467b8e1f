"""Process that compiles kernels: reads names of jobs, a line each, and answers each with a line when it is done."""

from __future__ import annotations

import gc
import os
import sys

# numba keeps most of what it makes for a kernel: garbage collection as often as Python's default takes a twentieth of
# the compilation.
_COLLECTION = 20_000, 50, 100
# Type inference formats the messages of its failed attempts and discards them.
_PLAIN_MESSAGES = "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING"


def main() -> None:
    """Work until the input ends."""
    os.environ[_PLAIN_MESSAGES] = "1"
    from daemon.kernels.jobs import run_job

    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # whatever a library prints is no answer
    gc.set_threshold(*_COLLECTION)
    for line in sys.stdin:
        run_job(line.strip())
        answers.write("done\n")
        answers.flush()


if __name__ == "__main__":
    main()
