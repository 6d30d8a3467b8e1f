"""``python -m fringed`` and the command ``fringed``, where the packages of a rig PC are installed too."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from typing import Any

import fringed

_RIG = "fringed-rig"
_CLIENT_ONLY = (
    "fringed: only the client is installed, which has no commands (from fringed import subscribe); install "
    f"those of a rig PC with: pip install {_RIG}"
)
_FOREIGN = (
    "fringed: the package 'daemon' in {place} is not that of {rig} but of {owner}; install {rig} into an environment "
    "of its own: python3 -m venv rig-env && rig-env/bin/pip install {rig}"
)


def main() -> int:
    """Run the command line; exit status 2, with the way to install it, where it is not, or was overwritten."""
    arguments = sys.argv[1:]
    if arguments in (["--version"], ["-V"]):
        print(f"fringed {fringed.__version__}")  # noqa: T201
        return 0
    problem = _problem()
    if problem:
        print(problem, file=sys.stderr)  # noqa: T201
        return 2
    sys.argv[0] = "fringed"
    entry: Any = import_module("daemon.cli.entry")
    entry.main()
    return 0


def command() -> None:
    """The console command."""
    sys.exit(main())


def _problem() -> str:
    """Why there is no command line; other distributions own a package ``daemon``, and pip overwrites its files."""
    package: Any = None
    try:
        package = import_module("daemon")
    except ImportError as error:
        if error.name == "daemon":
            return _CLIENT_ONLY
    if getattr(package, "DISTRIBUTION", "") == _RIG:
        return ""
    try:
        version(_RIG)
    except PackageNotFoundError:
        return _CLIENT_ONLY
    owners = [name for name in packages_distributions().get("daemon", []) if name not in (_RIG, "fringed")]
    place = ", ".join(getattr(package, "__path__", ())) or "this environment"
    return _FOREIGN.format(place=place, rig=_RIG, owner=", ".join(sorted(set(owners))) or "another program")


if __name__ == "__main__":
    command()
