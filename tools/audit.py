#!/usr/bin/env python3
"""Audit the pinned dependencies (constraints.txt) for known vulnerabilities: ``tools/audit.py [CONSTRAINTS]``.

A finding gives exit status 1. Without a source of advisories it prints NOT AUDITED and gives 0. An empty source reports
no vulnerability at all, so a source is used only if it lists a release that is known to be vulnerable.
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
    """No source of advisories is available."""


def main(arguments: list[str]) -> int:
    """Audit and return the exit status."""
    constraints = Path(arguments[0]) if arguments else ROOT / "constraints.txt"
    pinned = [line for line in constraints.read_text(encoding="utf-8").splitlines() if "==" in line]
    try:
        program = installed(ENVIRONMENT)
        if not vulnerable([KNOWN_BAD], program, _PROBE_S):
            raise NotAuditedError(f"the source of advisories does not list {KNOWN_BAD}, which is vulnerable")
        found = vulnerable(pinned, program, _AUDIT_S)
    except NotAuditedError as why:
        print_line(f"NOT AUDITED: {why}")
        return 0
    for line in found:
        print_line(line)
    print_line(f"{len(pinned)} packages audited, {len(found)} known vulnerabilities")
    return int(bool(found))


def installed(environment: Path) -> list[str]:
    """Install pip-audit in an environment of its own and return its command."""
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
    """Return a line for each known vulnerability of these releases."""
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


def findings(report: dict[str, list[dict[str, object]]], requested: int) -> list[str]:
    """Return the vulnerabilities of a report of pip-audit; NotAuditedError if it left packages out."""
    packages = report.get("dependencies", [])
    skipped = [str(one.get("name")) for one in packages if "skip_reason" in one]
    if skipped or len(packages) < requested:
        raise NotAuditedError(f"{len(packages) - len(skipped)} of {requested} packages have an answer")
    lines = []
    for one in packages:
        for problem in one.get("vulns", []):  # type: ignore[attr-defined]
            fixed = ", ".join(problem["fix_versions"]) or "no release yet"
            lines.append(f"{one['name']} {one['version']}: {problem['id']}, fixed in {fixed}")
    return lines


def run(command: list[str], timeout_s: float, *, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a program and capture its output."""
    return subprocess.run(
        command, capture_output=True, text=True, timeout=timeout_s, check=check, stdin=subprocess.DEVNULL
    )


def short(error: Exception) -> str:
    """Return an error as one line."""
    lines = str(getattr(error, "stderr", None) or error).strip().splitlines()
    return lines[-1][:200] if lines else type(error).__name__


def print_line(text: str) -> None:
    """Write one line to standard output."""
    sys.stdout.write(text + "\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
