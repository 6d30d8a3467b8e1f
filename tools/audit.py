#!/usr/bin/env python3
"""Audit the pinned dependencies (constraints.txt) for known vulnerabilities: ``tools/audit.py [CONSTRAINTS]``.

A finding gives exit status 1. Where no source of advisories can be asked, it says NOT AUDITED and gives 0. A source
that knows nothing finds nothing wrong with anything: it is first asked about a release that is known to be vulnerable,
and believed only if it says so.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = ROOT / ".audit-venv"
KNOWN_BAD = "jinja2==2.4.1"  # CVE-2014-1402, CVE-2019-10906 and others
_INSTALL_S, _PROBE_S, _AUDIT_S = 180.0, 60.0, 300.0


class NotAuditedError(Exception):
    """Nobody could be asked."""


def main(arguments: list[str]) -> int:
    """The exit status."""
    constraints = Path(arguments[0]) if arguments else ROOT / "constraints.txt"
    pinned = [line for line in constraints.read_text(encoding="utf-8").splitlines() if "==" in line]
    try:
        program = installed(ENVIRONMENT)
        if not vulnerable([KNOWN_BAD], program, _PROBE_S):
            raise NotAuditedError(f"the source of advisories does not know that {KNOWN_BAD} is vulnerable")
        found = vulnerable(pinned, program, _AUDIT_S)
    except NotAuditedError as why:
        say(f"NOT AUDITED: {why}")
        return 0
    for line in found:
        say(line)
    say(f"{len(pinned)} packages audited, {len(found)} known vulnerabilities")
    return int(bool(found))


def installed(environment: Path) -> list[str]:
    """The command of pip-audit, in an environment of its own."""
    python = environment / "bin" / "python"
    try:
        if not python.exists():
            venv.create(environment, with_pip=True)
        quiet = ["--quiet", "--disable-pip-version-check", "--retries", "1", "--timeout", "15"]
        run([str(python), "-m", "pip", "install", *quiet, "pip-audit>=2.7"], _INSTALL_S)
    except (OSError, subprocess.SubprocessError) as error:
        raise NotAuditedError(f"pip-audit cannot be installed: {short(error)}") from error
    return [str(python), "-m", "pip_audit"]


def vulnerable(pinned: list[str], program: list[str], timeout_s: float) -> list[str]:
    """A line for each known vulnerability of these releases."""
    with tempfile.TemporaryDirectory() as folder:
        wanted = Path(folder) / "pinned.txt"
        wanted.write_text("\n".join(pinned) + "\n", encoding="utf-8")
        options = ["--no-deps", "--disable-pip", "--progress-spinner", "off", "--format", "json", "--timeout", "20"]
        try:
            done = run([*program, *options, "--requirement", str(wanted)], timeout_s, check=False)
            report = json.loads(done.stdout)
        except (OSError, subprocess.SubprocessError, ValueError) as error:
            raise NotAuditedError(f"no source of advisories answers: {short(error)}") from error
    return list(findings(report, len(pinned)))


def findings(report: dict[str, list[dict[str, object]]], asked: int) -> list[str]:
    """What a report of pip-audit says; NotAuditedError if it left packages out."""
    told = report.get("dependencies", [])
    skipped = [str(one.get("name")) for one in told if "skip_reason" in one]
    if skipped or len(told) < asked:
        raise NotAuditedError(f"{len(told) - len(skipped)} of {asked} packages could be looked up")
    lines = []
    for one in told:
        for problem in one.get("vulns", []):  # type: ignore[attr-defined]
            mended = ", ".join(problem["fix_versions"]) or "nothing yet"
            lines.append(f"{one['name']} {one['version']}: {problem['id']}, mended in {mended}")
    return lines


def run(command: list[str], timeout_s: float, *, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a program and keep what it says."""
    return subprocess.run(
        command, capture_output=True, text=True, timeout=timeout_s, check=check, stdin=subprocess.DEVNULL
    )


def short(error: Exception) -> str:
    """An error in one line."""
    told = str(getattr(error, "stderr", None) or error).strip().splitlines()
    return told[-1][:200] if told else type(error).__name__


def say(text: str) -> None:
    """One line."""
    sys.stdout.write(text + "\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
