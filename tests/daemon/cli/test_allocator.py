"""The process's settings: memory of large arrays is reused, and the user's environment has priority."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from daemon.cli.allocator import SPIN_COUNT

_FAULTS = """
import resource, sys, threading
import numpy as np
from daemon.cli.allocator import prepare
if "tuned" in sys.argv:
    prepare()

def make():
    for _ in range(n):
        kept = [np.empty(10 << 20, np.uint8) for _ in range(3)]
        for array in kept:
            array.fill(1)

def faults(count):
    global n
    n, before = count, resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults(3)
print(faults(20))
"""


def python(code: str, *arguments: str, **environment: str) -> str:
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "OMP_", "GOMP_"))}
    command = [sys.executable, "-c", code, *arguments]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env=plain | environment)
    return process.stdout.strip()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_repeated_large_arrays_need_no_new_pages() -> None:
    assert int(python(_FAULTS, "tuned")) < 200


_ENVIRONMENT = (
    "import os; from daemon.cli.allocator import prepare; prepare(); "
    "print(os.environ['OMP_WAIT_POLICY'], os.environ.get('GOMP_SPINCOUNT'))"
)


def test_idle_threads_sleep_soon_unless_the_user_sets_otherwise() -> None:
    assert python(_ENVIRONMENT) == f"PASSIVE {SPIN_COUNT}"
    assert python(_ENVIRONMENT, OMP_WAIT_POLICY="ACTIVE") == "ACTIVE None"
    assert python(_ENVIRONMENT, GOMP_SPINCOUNT="7") == "PASSIVE 7"


def test_every_command_starts_with_the_settings() -> None:
    code = "import os, sys; from daemon.cli import entry; entry.run = lambda _: print(os.environ['OMP_WAIT_POLICY']); "
    code += "sys.argv = ['fringed']; entry.main()"
    assert python(code) == "PASSIVE"
