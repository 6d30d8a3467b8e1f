"""On a cluster of processes the results are those of a replay, whichever process dies meanwhile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from daemon.apps.reprocess.engine.dask_engine import DaskEngine, connected
from daemon.apps.reprocess.engine.tasks import EngineLostError
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.plan.recordings import recordings_of
from daemon.apps.reprocess.run import Run
from daemon.common.errors import DaemonError
from tests.daemon.apps.reprocess import cluster
from tests.daemon.apps.reprocess.takes import files_of, replayed, write
from tests.daemon.recording import small_take
from tools.waiting import wait_until

pytest.importorskip("distributed")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(240), pytest.mark.filterwarnings("default")]

Images = list[small_take.Images]
Expected = dict[str, dict[str, bytes]]


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory, images: Images) -> Path:
    """Two recordings, one of them cut off."""
    folder = tmp_path_factory.mktemp("takes")
    data = write(folder / "whole.mcap", images, 16).read_bytes()
    (folder / "cut.mcap").write_bytes(data[: int(0.7 * len(data))])
    return folder


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a scheduler that no test ends."""
    with cluster.scheduler(tmp_path_factory.mktemp("scheduler")) as (_, address):
        yield address


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> Iterator[str]:
    """Address of that scheduler, which has two workers; each is started again when it dies."""
    with cluster.workers(scheduler, 2, tmp_path_factory.mktemp("workers")):
        yield scheduler


@pytest.fixture
def engine(two_workers: str) -> Iterator[DaskEngine]:
    """The engine with both of them, also after a test that killed some."""
    with connected(two_workers) as engine:
        engine._client.wait_for_workers(2, timeout=60)
        yield engine


@pytest.fixture(scope="module")
def expected(sources: Path) -> Expected:
    """Clouds by recording."""
    return {name: replayed(sources / f"{name}.mcap")[0] for name in ("whole", "cut")}


def expect_results(expected: Expected, out: Path) -> None:
    for name, clouds in expected.items():
        assert files_of(out / name) == clouds
        assert (out / name / "summary.json").exists()


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_local_cluster_gives_the_results_and_a_report(
    sources: Path, tmp_path: Path, expected: Expected, fringed: Callable[..., subprocess.CompletedProcess[str]],
    workers: int,
) -> None:  # fmt: skip
    done = fringed("reprocess", str(sources), "--out", str(tmp_path), "--workers", str(workers), "--chunk", "4")
    assert done.returncode == 0, done.stderr
    assert f"{workers} workers; dashboard: http://127.0.0.1:" in done.stderr
    assert "the file was cut off at byte" in done.stderr
    assert "pairs of 2 recordings done" in done.stdout
    expect_results(expected, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["failures"] == [] and report["done"] == report["items"]
    assert b"<svg" in (tmp_path / "report.html").read_bytes()


@pytest.mark.parametrize("deaths", [1, pytest.param(2, marks=pytest.mark.long)])
def test_killed_workers_cost_no_result(
    sources: Path, tmp_path: Path, expected: Expected, engine: DaskEngine, deaths: int
) -> None:
    killed: list[str] = []

    def interrupted(dask_scheduler: Any) -> bool:
        """Whether the dead worker is still listed, or a task that it held is not done: a second death would end it."""
        waiting = any(t.suspicious and t.state not in ("memory", "released") for t in dask_scheduler.tasks.values())
        return waiting or any(address in dask_scheduler.workers for address in killed)

    def kill_one(totals: object) -> None:
        due = len(killed) < deaths and getattr(totals, "computed", 0) > 4 * len(killed)
        if due and not engine._client.run_on_scheduler(interrupted):
            address, victim = next(iter(engine._client.run(os.getpid).items()))
            os.kill(victim, signal.SIGKILL)
            killed.append(address)

    totals = Run(Job(chunk_pairs=2), tmp_path, engine, observe=kill_one).run(recordings_of([str(sources)]))
    assert len(killed) == deaths and not totals.failures
    expect_results(expected, tmp_path)


@pytest.mark.long  # starts a cluster of its own
def test_after_the_death_of_the_scheduler_the_same_command_completes_the_results(
    sources: Path, tmp_path: Path, expected: Expected, engine: DaskEngine
) -> None:
    out = tmp_path / "out"
    with (
        cluster.scheduler(tmp_path) as (process, address),
        cluster.workers(address, 1, tmp_path),
        connected(address) as lost,
    ):

        def kill_scheduler(totals: object) -> None:
            if getattr(totals, "computed", 0) > 4:
                process.kill()

        run = Run(Job(chunk_pairs=2), out, lost, observe=kill_scheduler)
        with pytest.raises(EngineLostError, match="run the same command again"):
            run.run(recordings_of([str(sources)]))
        wait_until(lambda: process.poll() is not None, 10, "the end of the scheduler")
    totals = Run(Job(chunk_pairs=2), out, engine).run(recordings_of([str(sources)]))
    assert not totals.failures and totals.computed < totals.done == totals.items
    expect_results(expected, out)


def hungry(megabytes: int) -> None:
    kept = bytes(megabytes << 20).replace(b"\0", b"x")
    time.sleep(60)  # until the nanny ends the process
    del kept


def suicidal() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def ended(engine: object, function: Callable[..., object], *arguments: object) -> str:
    """The reason that a task of a cluster ended with."""
    engine.submit("it", function, *arguments)  # type: ignore[attr-defined]
    found: list[str] = []
    wait_until(lambda: bool(found.extend(one.error for one in engine.wait(1.0)) or found), 120, "the end")  # type: ignore[attr-defined,func-returns-value]
    return found[0]


@pytest.mark.long  # starts four workers again; workers are killed above
def test_a_killed_worker_is_explained(engine: DaskEngine) -> None:
    reason = ended(engine, suicidal)
    assert "2 worker processes died doing it" in reason
    assert "none reported that it reached its memory limit" in reason


@pytest.mark.long  # starts a cluster of its own; a worker that dies is explained above
def test_a_worker_that_was_ended_for_lack_of_memory_is_named_as_such(tmp_path: Path) -> None:
    limit = "--memory-limit", "500MiB"
    with (
        cluster.scheduler(tmp_path) as (_, address),
        cluster.workers(address, 1, tmp_path, *limit),
        connected(address) as engine,
    ):
        reason = ended(engine, hungry, 700)
    assert "2 worker processes that did it were ended for lack of memory" in reason
    assert "MiB); give workers more memory (--memory-limit)" in reason


def test_workers_have_one_task_thread_and_one_thread_of_numba(engine: DaskEngine) -> None:
    threads = engine._client.run(numba_threads)
    assert set(engine._client.nthreads().values()) == {1}
    assert engine.slots == 2
    assert set(threads.values()) == {(1, "1", "1")}


def numba_threads() -> tuple[int, str | None, str | None]:
    import numba

    return numba.config.NUMBA_NUM_THREADS, os.environ.get("OMP_NUM_THREADS"), os.environ.get("MALLOC_ARENA_MAX")


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.apps.reprocess.engine.dask_engine._CONNECT_S", 1)
    with (
        pytest.raises(DaemonError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers there"),
        connected("tcp://127.0.0.1:9"),
    ):
        pass
