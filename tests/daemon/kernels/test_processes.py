"""Processes compile each job once, report progress, and end with an error that names the job."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.common.errors import DaemonError
from daemon.kernels import cache, processes
from daemon.kernels.jobs import measuring_jobs
from daemon.kernels.processes import KernelCompilation, Progress, compile_kernels, compiling_ahead


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A mark in memory: the kernels themselves are in the cache already."""
    jobs: list[str] = []
    monkeypatch.setattr(cache, "compiled_jobs", lambda: frozenset(jobs))
    monkeypatch.setattr(cache, "note_compiled", jobs.extend)
    monkeypatch.setattr(cache, "discard_outdated", lambda: 0)
    return jobs


def test_every_job_is_done_once_and_counted(noted: list[str]) -> None:
    jobs = [job for job in measuring_jobs("rgb8") if "order" in job or "monitor" in job]
    seen: list[Progress] = []
    compile_kernels(jobs, seen.append)
    assert sorted(noted) == sorted(jobs)
    assert seen[-1] == (2, 2)
    assert [p.done for p in seen] == sorted(p.done for p in seen)


def test_nothing_is_started_when_all_is_compiled(noted: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    noted.extend(measuring_jobs("rgb8"))
    monkeypatch.setattr(processes.subprocess, "Popen", None)
    compile_kernels(measuring_jobs("rgb8"))
    assert KernelCompilation(measuring_jobs("rgb8")).progress == (len(measuring_jobs("rgb8")),) * 2


@pytest.mark.parametrize("job", ["cook/rgb8/soup", "no job"])
def test_a_failure_names_the_job(noted: list[str], job: str) -> None:
    with pytest.raises(DaemonError, match=f"(?s)the compilation of the kernels failed:\n{job}: .*ValueError"):
        compile_kernels([job])
    assert noted == []


def test_what_was_started_ahead_is_waited_for(noted: list[str]) -> None:
    job = next(job for job in measuring_jobs("rgb8") if "monitor" in job)
    with compiling_ahead([job]):
        compile_kernels([job])
        assert noted == [job]


def test_the_processes_end_with_the_context(noted: list[str]) -> None:
    with compiling_ahead(measuring_jobs("rgb8")):
        (running,) = processes._running
    assert processes._running == []
    assert all(process.returncode is not None for process in running._processes)
    assert set(noted) <= set(measuring_jobs("rgb8"))


def test_the_key_covers_the_sources() -> None:
    assert Path(cache.ROOT / "pipeline/match/subpixel_match.py").is_file()
    assert len(cache.cache_key()) == 32
