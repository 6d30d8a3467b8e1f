"""Which kernels of a release a machine uses; an installed wheel compiles nothing."""

from __future__ import annotations

import logging
import os
import platform
import sys
import sysconfig
from pathlib import Path

import pytest

from daemon.kernels import cache, release
from daemon.kernels.archive import pack
from daemon.kernels.jobs import MEASURE, measuring_jobs
from tools.release import build_wheels, compile_archive
from tools.release_check import compilations, new_environment

PYTHON = f"cp{sys.version_info.major}{sys.version_info.minor}"
NAMES = "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_CACHE_DIR"


@pytest.fixture(autouse=True)
def own_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.setenv(name, "")  # so that what a test sets is undone
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(release, "FOLDER", tmp_path / "compiled")
    monkeypatch.setattr(release, "levels", lambda: ["x86-64-v4", "x86-64-v3"])


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A release with an archive that has no kernel but a mark, for the lower level."""
    with monkeypatch.context() as patch:
        patch.setenv("NUMBA_CPU_NAME", "x86-64-v3")
        patch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cached"))
        cache.cache_key.cache_clear()
        cache.note_compiled(["a"])
        description = pack(tmp_path / "cached", release.FOLDER, "x86-64-v3")
    cache.cache_key.cache_clear()
    return description


@pytest.fixture(autouse=True)
def own_key() -> object:
    yield
    cache.cache_key.cache_clear()


def selected() -> list[str | None]:
    return [os.environ.get(name) for name in NAMES]


def cpuinfo(folder: Path, *flags: set[str]) -> Path:
    path = folder / "cpuinfo"
    path.write_text("".join(f"processor\t: {k}\nflags\t\t: {' '.join(sorted(f))}\n\n" for k, f in enumerate(flags)))
    return path


@pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")
def test_a_level_needs_all_its_flags_on_all_processors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    v4, v3 = release.LEVELS["x86-64-v4"], release.LEVELS["x86-64-v3"]
    assert release.levels(cpuinfo(tmp_path, v4 | {"sse"})) == ["x86-64-v4", "x86-64-v3"]
    assert release.levels(cpuinfo(tmp_path, v4, v3)) == ["x86-64-v3"]
    assert all(release.levels(cpuinfo(tmp_path, v3 - {flag})) == [] for flag in v3)
    assert release.levels(cpuinfo(tmp_path)) == release.levels(tmp_path / "nothing") == []


def test_another_architecture_has_no_level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert release.levels(cpuinfo(tmp_path, release.LEVELS["x86-64-v4"])) == []


def test_a_checkout_compiles_for_its_own_processor() -> None:
    release.select()
    assert selected() == [None, None, None]


@pytest.mark.usefixtures("shipped")
def test_the_highest_level_with_an_archive_is_used(tmp_path: Path) -> None:
    release.select()
    name, features, folder = selected()
    assert (name, features) == ("x86-64-v3", "")
    assert folder is not None and Path(folder).parent == tmp_path / "cache/fringed/kernels"
    release.unpack()
    assert cache.compiled_jobs() == {"a"}


@pytest.mark.usefixtures("shipped")
def test_a_folder_that_the_user_names_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    release.select()
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == tmp_path / "mine"
    before = selected()
    release.select()  # as in a child process
    assert selected() == before


@pytest.mark.usefixtures("shipped")
def test_a_processor_that_the_user_names_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    release.select()
    release.unpack()
    assert selected() == ["generic", None, None]


@pytest.mark.usefixtures("shipped")
@pytest.mark.parametrize("machine", [["x86-64-v4"], []])
def test_a_machine_without_an_archive_compiles(machine: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(release, "levels", lambda: machine)
    release.select()
    assert selected() == [None, None, None]


@pytest.mark.parametrize("reason", ["damaged", "other sources", "no folder"])
def test_what_cannot_be_used_is_compiled_with_a_logged_reason(
    shipped: Path, tmp_path: Path, reason: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    if reason == "damaged":
        shipped.with_suffix(".tar.xz").write_bytes(b"?")
    elif reason == "other sources":
        monkeypatch.setattr(cache, "sources_key", lambda: "of other sources")
    else:
        (tmp_path / "cache").write_text("a file")
    release.select()
    with caplog.at_level(logging.WARNING):
        release.unpack()
    assert len(caplog.messages) == 1
    assert caplog.messages[0].startswith("the kernels of the release are not used, they are compiled here: ")
    assert reason in caplog.text or reason == "no folder"
    assert cache.compiled_jobs() == frozenset()


@pytest.mark.slow
def test_an_installed_wheel_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    if not release.levels():
        pytest.skip("kernels are shipped for x86-64-v3 and v4, which this processor cannot run")
    jobs = [job for job in measuring_jobs("rgb8") if job.startswith(MEASURE) and "uniqueness" in job]
    compile_archive(release.levels()[0], tmp_path / "kernels", jobs)
    wheels = build_wheels(tmp_path, tmp_path / "kernels")
    python = new_environment(tmp_path / "env", wheels, ["--no-deps", "--no-index", "--no-compile"])
    (own,) = (tmp_path / "env").glob("lib/python3.*/site-packages")
    (own / "others.pth").write_text(f"{sysconfig.get_paths()['purelib']}\n")  # all other packages, of this environment
    assert compilations(python, tmp_path, release.levels()[0], jobs) == (0, "")
