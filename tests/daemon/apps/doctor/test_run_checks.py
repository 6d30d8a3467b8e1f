"""Properties of every finding and every run."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest

from daemon.apps.doctor import report
from daemon.apps.doctor.check_table import AREAS
from daemon.apps.doctor.finding import LEVELS, Finding, Level, counts, exit_code
from daemon.apps.doctor.run_checks import run_checks
from tests.daemon.apps.doctor import bad_checks
from tools.waiting import wait_until


@pytest.mark.parametrize("level", ["warning", "problem"])
def test_warnings_and_problems_require_a_remedy(level: Level) -> None:
    with pytest.raises(ValueError, match="remedy"):
        Finding("disk", "room", level, "full")


def test_the_exit_code_is_1_exactly_with_a_problem() -> None:
    for chosen in itertools.product(LEVELS, repeat=3):
        findings = [Finding("a", "b", level, "text", "remedy") for level in chosen]
        assert exit_code(findings) == int("problem" in chosen)
        assert sum(counts(findings).values()) == 3
        assert report.as_json(findings, None)["healthy"] == ("problem" not in chosen)


def test_areas_have_unique_names_and_existing_targets() -> None:
    import importlib

    assert len({check.area for check in AREAS}) == len(AREAS)
    for check in AREAS:
        module, _, name = check.target.partition(":")
        assert callable(getattr(importlib.import_module(module), name))


def test_an_exception_in_a_check_becomes_a_finding_beside_its_earlier_ones() -> None:
    found = run_checks(checks=[bad_checks.check("raises"), bad_checks.WELL])
    assert [finding.level for finding in found] == ["ok", "problem", "ok"]
    assert "KeyError" in found[1].text and "Exposure" in found[1].text


def test_a_crash_of_a_check_becomes_a_finding_and_the_others_continue() -> None:
    found = run_checks(checks=[bad_checks.WELL, bad_checks.check("crashes"), bad_checks.WELL])
    assert [finding.area for finding in found] == ["well", "sick", "well"]
    assert found[1].level == "problem" and "SIGSEGV" in found[1].text and "--only sick" in found[1].remedy


def test_a_check_that_hangs_is_ended_with_its_children(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SICK_CHILD", str(tmp_path / "child"))
    found = run_checks(checks=[bad_checks.check("hangs", timeout_s=3.0), bad_checks.WELL])
    assert [finding.area for finding in found] == ["sick", "well"]
    assert found[0].level == "problem" and "in time" in found[0].text
    child = int((tmp_path / "child").read_text())
    wait_until(lambda: not _runs(child))


def test_a_library_with_much_output_does_not_disturb_its_check() -> None:
    assert [finding.name for finding in run_checks(checks=[bad_checks.check("prints")])] == ["prints"]


def test_each_area_is_reported_as_soon_as_it_is_complete() -> None:
    reported: list[list[str]] = []
    run_checks(
        checks=[bad_checks.WELL, bad_checks.check("crashes"), bad_checks.WELL],
        on_area=lambda f: reported.append([x.area for x in f]),
    )
    assert reported == [["well"], ["sick"], ["well"]]


def test_long_texts_are_wrapped_and_commands_are_not_broken() -> None:
    command = "echo 1000 | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb"
    finding = Finding("usb", "memory", "warning", "word " * 60, f"{command}; {command}")
    lines = ["".join(report.columns(line)) for line in report.lines([finding])]
    assert all(len(line.rstrip()) <= report.WIDTH for line in lines) and lines[0].startswith("usb ")
    assert "/sys/module/usbcore/parameters/usbfs_memory_mb" in "\n".join(lines)


def test_the_measuring_daemon_never_imports_the_doctor() -> None:
    code = (
        "import sys, daemon.bootstrap.run, daemon.cli.measure.run\n"
        "print([name for name in sys.modules if name.startswith('daemon.apps.doctor')])"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert process.stdout.strip() == "[]", process.stderr


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False
