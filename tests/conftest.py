"""What all tests share: compiled kernels, the order and distribution of tests, commands, and the public data sets.

``make test`` distributes the files over worker processes (pytest-xdist): a file stays together, so that its fixtures
are made once; what shares a resource carries the same ``xdist_group``. Kernels are compiled once, before the workers.
"""

from __future__ import annotations

import fcntl
import gc
import os
import random
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from tests import bytecode, kernels

hypothesis.settings.register_profile("fixed", derandomize=True, database=None)
hypothesis.settings.load_profile("fixed")

HERE = Path(__file__).parent
UMASK = 0o022
"""The umask of every test, independent of the caller's."""
os.umask(UMASK)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background job, whose children ignore it as well
    signal.signal(signal.SIGINT, signal.default_int_handler)

WITHOUT_KERNELS = (
    "daemon/apps", "daemon/cli/control", "daemon/common", "daemon/config", "daemon/control", "daemon/keys",
    "daemon/live/acquisition", "daemon/live/publishing", "daemon/rig", "distributions", "drivers",
    "fringed/conformance", "fringed/control", "fringed/test_main.py", "fringed/test_receiver.py",
    "fringed/test_wire.py",
    "pipeline/calibrate", "pipeline/pattern", "sim/boards", "sim/gentl", "test_module_names.py", "tools",
)  # fmt: skip
"""Directories of tests that neither measure nor render, or little: their kernels are compiled when they are called."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run files, and tests within each, in random order")


def pytest_sessionstart(session: pytest.Session) -> None:
    """With workers, compile before they start."""
    if session.config.getoption("numprocesses", None) and not _is_worker(session.config):
        bytecode.rewrite_all(session.config, HERE)
        named = [Path(arg.partition("::")[0]).resolve() for arg in session.config.args]
        _compile_kernels(session.config, named)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Without workers, compile before the first test; the time-outs of the tests do not count it."""
    gc.collect()
    gc.freeze()  # a million objects of modules and tests: each full collection would visit them again
    if not session.config.getoption("numprocesses", None) and not _is_worker(session.config):
        _compile_kernels(session.config, [item.path for item in session.items])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Shuffle if asked for; else, for workers, files with slow tests come first, so that they end together."""
    if any(item.get_closest_marker("threads") and not item.path.is_relative_to(HERE / "pipeline") for item in items):
        raise pytest.UsageError("make test collects tests marked threads from tests/pipeline only")
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    groups = list(files.values())
    seed = config.getoption("--shuffle")
    if seed is not None:
        shuffled = random.Random(seed)
        shuffled.shuffle(groups)
        for group in groups:
            shuffled.shuffle(group)
            group.sort(key=lambda item: item.get_closest_marker("last") is not None)
    elif _is_worker(config):
        groups.sort(key=lambda group: not any(item.get_closest_marker("slow") for item in group))
    items[:] = [item for group in groups for item in group]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A test that compares numbers of threads would pass with one."""
    if item.get_closest_marker("threads") is not None and os.environ.get("NUMBA_NUM_THREADS") == "1":
        pytest.fail("this test compares numbers of threads: run it without NUMBA_NUM_THREADS=1")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Files are the units of work, but for tests with an ``xdist_group``."""
    from xdist.scheduler import LoadGroupScheduling

    class ByFile(LoadGroupScheduling):
        def _split_scope(self, nodeid: str) -> str:
            scope: str = super()._split_scope(nodeid)
            return scope.partition("::")[0] if scope == nodeid else scope

    return ByFile(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run a test marked ``alone`` while no other worker runs one; outside of time-outs."""
    if not _is_worker(item.config):
        return (yield)
    run: str = item.config.workerinput["testrunuid"]  # type: ignore[attr-defined]
    with _turn(Path(tempfile.gettempdir()) / f"fringed-tests-{run}", item.get_closest_marker("alone") is not None):
        return (yield)


@contextmanager
def _turn(name: Path, alone: bool) -> Iterator[None]:
    """A lock that many may share, or one may hold exclusively; later callers wait behind one that waits for that."""
    with ExitStack() as stack:
        queue = stack.enter_context(name.with_suffix(".queue").open("w"))
        turn = stack.enter_context(name.with_suffix(".turn").open("w"))
        fcntl.flock(queue, fcntl.LOCK_EX)
        fcntl.flock(turn, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(queue, fcntl.LOCK_UN)
        yield


def _is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


def _compile_kernels(config: pytest.Config, paths: list[Path]) -> None:
    """Compile what tests in these files and folders need."""
    without = [HERE / each for each in WITHOUT_KERNELS]
    if config.option.collectonly or all(any(map(path.is_relative_to, without)) for path in paths):
        return
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and reporter.verbosity >= 0:
        reporter.write_line("loading the kernels; after a change they are compiled, which takes minutes")
    problem = kernels.compile_all()
    if problem:
        pytest.exit(f"the kernels do not compile:\n{problem}", returncode=pytest.ExitCode.INTERNAL_ERROR)


@pytest.fixture(autouse=True)
def own_umask() -> Iterator[None]:
    """Commands that run inside the tests' process close their files to others; that must not reach the next test."""
    yield
    os.umask(UMASK)


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background job, whose children ignore it as well
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_data() -> Callable[..., Path]:
    """``shared_data("bust", "take.mcap")`` is a file of the public data sets.

    They are beside the repository (or where FRINGED_SHARED_DATA points) and no part of it: without them the test
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
