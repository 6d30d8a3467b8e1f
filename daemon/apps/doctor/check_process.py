"""The process that runs the checks: ``python -m daemon.apps.doctor.check_process FD PARENT JOB``.

Results are written to file descriptor FD, one JSON line for each area, apart from the output of vendors' libraries. An
exception becomes a finding here; a crash or a hang of this process becomes one in
:mod:`daemon.apps.doctor.run_checks`.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from daemon.apps.doctor.check_table import Check
from daemon.apps.doctor.finding import Finding
from daemon.apps.doctor.machine import Machine
from daemon.apps.doctor.rig.rig_file import read_leniently
from daemon.apps.doctor.subject import Subject
from drivers.child_process import die_with_parent


class Job(msgspec.Struct, frozen=True):
    """The checks to run, the rig (empty = none), and the root of /proc and /sys."""

    checks: tuple[Check, ...]
    rig: str = ""
    root: str = "/"


class AreaResult(msgspec.Struct, frozen=True):
    """The findings of one area; the first message has no area and reports that the process is ready."""

    area: str = ""
    findings: tuple[Finding, ...] = ()


def main() -> None:
    """Run the checks one after the other."""
    os.setpgid(0, 0)
    die_with_parent(int(sys.argv[2]))
    job = msgspec.json.decode(sys.argv[3], type=Job)
    subject = make_subject(job)
    with open(int(sys.argv[1]), "wb", buffering=0) as out:  # noqa: PTH123 - a file descriptor
        out.write(msgspec.json.encode(AreaResult()) + b"\n")
        for check in job.checks:
            out.write(msgspec.json.encode(AreaResult(check.area, tuple(run_check(check, subject)))) + b"\n")


def make_subject(job: Job) -> Subject:
    """The machine and the rig of a job; only the machine if the rig is unreadable."""
    machine = Machine(Path(job.root))
    if not job.rig:
        return Subject(machine)
    config, _ = read_leniently(Path(job.rig))
    return Subject(machine, Path(job.rig), config)


def run_check(check: Check, subject: Subject) -> list[Finding]:
    """Run the check of one area; an exception is a finding too."""
    if subject.config is not None and check.drivers and not subject.drivers & set(check.drivers):
        return [Finding(check.area, "not needed", "note", f"not needed with {', '.join(sorted(subject.drivers))}")]
    if check.needs_rig and (subject.path is None or (subject.config is None and check.area != "rig")):
        return [Finding(check.area, "needs a rig.yaml", "note", "needs a rig.yaml")]
    findings: list[Finding] = []
    try:
        module, _, name = check.target.partition(":")
        function: Callable[[Subject], Iterable[Finding]] = getattr(importlib.import_module(module), name)
        findings.extend(function(subject))
    except Exception as error:
        text = f"the check itself failed: {type(error).__name__}: {error}"
        findings.append(Finding(check.area, "check", "problem", text[:600], f"{_REMEDY} {check.area}"))
    return findings or [Finding(check.area, "nothing", "note", "nothing to report")]


_REMEDY = "correct the named cause; repeat this check with: fringed doctor --only"


if __name__ == "__main__":
    main()
