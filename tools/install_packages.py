"""Install packages where the Python that runs this is: ``.venv/bin/python tools/install_packages.py PACKAGE ...``.

uv does it, in a fifth of pip's time. Where pip does not find uv or has settings without a counterpart, or uv fails, pip
does. Arguments are those of ``pip install``; versions are those of constraints.txt.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

CONSTRAINTS = ["--constraint", str(Path(__file__).parents[1] / "constraints.txt")]
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
UV = [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", sys.executable]
UV += ["--index-strategy", "unsafe-best-match"]  # all indexes count alike, as for pip
SOURCES = {"index-url": "--default-index", "extra-index-url": "--index", "find-links": "--find-links",
           "constraint": "--constraint"}  # fmt: skip
"""Settings of pip about where packages come from, which uv does not read, and its options."""
WITHOUT_EFFECT = {"cache-dir", "default-timeout", "disable-pip-version-check", "no-cache-dir", "no-color", "no-input",
                  "progress-bar", "quiet", "require-virtualenv", "retries", "root-user-action", "timeout"}  # fmt: skip
"""Settings that change nothing about what is installed; with any other, pip installs."""
SECTIONS = "global", "install", ":env:"
"""Of pip's settings, a later one replaces an earlier one; those of other commands are in others."""


def uv_options(settings: str) -> tuple[list[str], dict[str, str]] | None:
    """Options and environment variables of uv for what ``pip config list`` prints; None where it has none."""
    sections: dict[str, dict[str, list[str]]] = {section: {} for section in SECTIONS}
    for line in settings.splitlines():
        name, _, value = line.partition("=")
        section, _, key = name.rpartition(".")
        if section in sections:
            sections[section][key] = " ".join(shlex.split(value)).split()
    found = {key: values for section in SECTIONS for key, values in sections[section].items()}
    if found.keys() - SOURCES.keys() - WITHOUT_EFFECT - {"cert"}:
        return None
    options = [part for key, option in SOURCES.items() for each in found.get(key, []) for part in (option, each)]
    return options, {"SSL_CERT_FILE": found["cert"][0]} if found.get("cert") else {}


def main(arguments: Sequence[str]) -> int:
    """Install; returns the exit status."""
    install = [*PIP, "install", "--quiet", *CONSTRAINTS]
    settings = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=False).stdout
    options = uv_options(settings)
    if options is not None and not subprocess.run([*install, "uv"], capture_output=True, check=False).returncode:
        done = subprocess.run([*UV, *options[0], *CONSTRAINTS, *arguments], env=os.environ | options[1], check=False)
        if not done.returncode:
            return 0
        sys.stderr.write("uv does not install them; pip does\n")
    return subprocess.run([*install, *arguments], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
