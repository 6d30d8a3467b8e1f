"""``python -m fringed.conformance``: serve the recorded messages, print the expected results, check a client's."""

from __future__ import annotations

import argparse
import json
import sys
import threading
from pathlib import Path

from fringed.conformance import reference_client
from fringed.conformance.judge import problems
from fringed.conformance.recorded import expected
from fringed.conformance.server import Server


def main(arguments: list[str] | None = None) -> int:
    """Run one command; 1 when a client does not conform."""
    parser = argparse.ArgumentParser(prog="python -m fringed.conformance", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    serve = commands.add_parser("serve", help="replay the recorded messages until Ctrl-C")
    for socket, port in (("stream", 5655), ("control", 5658)):
        serve.add_argument(f"--{socket}", default=f"tcp://127.0.0.1:{port}", metavar="ADDRESS")
    commands.add_parser("expected", help="print the expected results as JSON")
    check = commands.add_parser("check", help="compare a client's results, lines of JSON; exit status 1 if they differ")
    check.add_argument("results", type=Path)
    client = commands.add_parser("client", help="the reference client: write its results to standard output")
    client.add_argument("stream", nargs="?", default="tcp://127.0.0.1:5655")
    client.add_argument("control", nargs="?", default="tcp://127.0.0.1:5658")
    options = parser.parse_args(arguments)
    if options.command == "serve":
        return _serve(options.stream, options.control)
    if options.command == "expected":
        sys.stdout.write(json.dumps(expected(), indent=1) + "\n")
        return 0
    if options.command == "client":
        reference_client.run(options.stream, options.control, sys.stdout)
        return 0
    found = problems(options.results.read_text(encoding="utf-8").splitlines(), expected())
    sys.stdout.writelines(f"{problem}\n" for problem in found)
    sys.stdout.write("conforming\n" if not found else f"{len(found)} problems\n")
    return int(bool(found))


def _serve(stream: str, control: str) -> int:
    with Server(stream, control) as server:
        sys.stdout.write(f"stream {server.stream}\ncontrol {server.control}\n")
        sys.stdout.flush()
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
