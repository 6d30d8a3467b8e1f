"""What all tests share: compiled kernels, and the public data sets, where they are there."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests import kernels

# As the program itself has it (daemon.cli.allocator), before anything imports numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

UMASK = 0o022
"""What every test begins with, whoever runs the tests."""
os.umask(UMASK)

WITHOUT_KERNELS = (
    "daemon/apps/calibration", "daemon/cli/calibrate", "daemon/live/publishing", "daemon/monitoring", "drivers",
    "fringed", "pipeline/calibrate", "sim/boards", "sim/gentl", "test_module_names.py", "tools",
)  # fmt: skip
"""Directories of tests that neither measure nor render."""


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile all kernels before the first test; the time-outs of the tests do not count it."""
    here = Path(__file__).parent
    places = {item.path.relative_to(here) for item in session.items}
    if session.config.option.collectonly or all(any(map(place.is_relative_to, WITHOUT_KERNELS)) for place in places):
        return
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and reporter.verbosity >= 0:
        reporter.write_line("loading the kernels; after a change they are compiled, which takes minutes")
    problem = kernels.compile_elsewhere()
    if problem:
        pytest.exit(f"the kernels do not compile:\n{problem}", returncode=pytest.ExitCode.INTERNAL_ERROR)


@pytest.fixture(autouse=True)
def own_umask() -> Iterator[None]:
    """Commands that run inside the tests' process close their files to others; that must not reach the next test."""
    yield
    os.umask(UMASK)


@pytest.fixture(scope="session")
def shared_data() -> Callable[..., Path]:
    """``shared_data("bust", "take.mcap")`` is a file of the public data sets.

    They stand beside the repository (or where FRINGED_SHARED_DATA says) and are no part of it: without them the test
    is skipped, in CI (environment variable CI) it fails.
    """
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    root = Path(os.environ.get("FRINGED_SHARED_DATA", beside))

    def find(*names: str) -> Path:
        path = root.joinpath(*names)
        if path.exists():
            return path
        reason = f"the public data set {path} is not there; set FRINGED_SHARED_DATA to its directory"
        if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
            pytest.fail(reason)
        pytest.skip(reason)

    return find


@pytest.fixture(scope="session")
def fringed() -> Callable[..., subprocess.CompletedProcess[str]]:
    """``fringed("info", "take.mcap")`` runs the command as a user would, in a process of its own."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        start = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
        return subprocess.run(
            [sys.executable, "-c", start, *arguments], capture_output=True, text=True, timeout=100, check=False
        )

    return run
