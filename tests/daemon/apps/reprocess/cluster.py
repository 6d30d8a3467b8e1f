"""A scheduler and workers as processes of their own, as users start them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.waiting import wait_until

START = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"


def command(*arguments: object) -> list[str]:
    """A command line of the program."""
    return [sys.executable, "-c", START, *map(str, arguments)]


@contextmanager
def process(arguments: list[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A process that is ended with the block, at the latest."""
    with subprocess.Popen(arguments, text=True, **options) as running:
        try:
            yield running
        finally:
            running.terminate()
            try:
                running.wait(10)
            except subprocess.TimeoutExpired:
                running.kill()


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A scheduler that gives a task to two workers at most; yields its process and address."""
    file = folder / f"scheduler-{len(list(folder.glob('scheduler-*')))}.json"
    arguments = ["--port", "0", "--no-dashboard", "--scheduler-file", str(file), "--host", "127.0.0.1"]
    start = [sys.executable, "-m", "distributed.cli.dask_scheduler", *arguments]
    environment = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    with process(start, stderr=subprocess.DEVNULL, cwd=folder, env=environment) as running:
        wait_until(lambda: file.exists() and file.read_text().endswith("}"), 30, "the scheduler's address")
        yield running, json.loads(file.read_text())["address"]


@contextmanager
def workers(address: str, count: int, folder: Path, *options: str) -> Iterator[None]:
    """A worker command of that many processes, registered at the scheduler."""
    from distributed import Client

    environment = os.environ | {"DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "0.95"}
    start = command("worker", address, "--workers", count, *options)
    with process(start, stderr=subprocess.DEVNULL, cwd=folder, env=environment):
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)
        yield
