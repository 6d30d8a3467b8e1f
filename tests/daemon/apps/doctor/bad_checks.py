"""Checks that fail in different ways, and one that succeeds."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.check_table import Check
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("sick")


def well(_: Subject) -> Iterator[Finding]:
    yield Area("well").ok("all", "well")


def raises(_: Subject) -> Iterator[Finding]:
    yield area.ok("before", "found before the failure")
    raise KeyError("Exposure")


def hangs(_: Subject) -> Iterator[Finding]:
    # A hanging child of the check must end too; its process id is passed through a file.
    child = subprocess.Popen(["sleep", "1000"])
    Path(os.environ["SICK_CHILD"]).write_text(str(child.pid))
    threading.Event().wait()
    yield area.ok("never", "never")


def crashes(_: Subject) -> Iterator[Finding]:
    os.kill(os.getpid(), signal.SIGSEGV)
    yield area.ok("never", "never")


def prints(_: Subject) -> Iterator[Finding]:
    os.write(1, b"output of a vendor's library\n" * 20_000)
    yield area.ok("prints", "done")


def check(name: str, area_name: str = "sick", timeout_s: float = 60.0) -> Check:
    return Check(area_name, f"tests.daemon.apps.doctor.bad_checks:{name}", timeout_s=timeout_s)


WELL = check("well", "well")
