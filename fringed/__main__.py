"""``python -m fringed``: the command line, where the packages of a rig PC are installed too."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

import fringed

_ENTRY = "daemon.cli.entry"
_CLIENT_ONLY = (
    "fringed: only the client is installed, which has no commands (from fringed import subscribe); install "
    "those of a rig PC with: pip install 'fringed[rig]'"
)


def main() -> int:
    """Run the command line; exit status 2, with the way to install it, where only the client is installed."""
    arguments = sys.argv[1:]
    if arguments in (["--version"], ["-V"]):
        print(f"fringed {fringed.__version__}")  # noqa: T201
        return 0
    try:
        entry: Any = import_module(_ENTRY)
    except ModuleNotFoundError as error:  # also where another distribution has a package of the name daemon
        if error.name not in ("daemon", "daemon.cli", _ENTRY):
            raise
        print(_CLIENT_ONLY, file=sys.stderr)  # noqa: T201
        return 2
    sys.argv[0] = "fringed"
    entry.main()
    return 0


if __name__ == "__main__":
    sys.exit(main())
