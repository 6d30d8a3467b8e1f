"""``python -m tools.nspawn [COMMAND ...]``: run a command in a fresh container; without one, wait until Ctrl-C."""

from __future__ import annotations

import signal
import sys

from tools.nspawn.machine import Machine, missing


def main(command: list[str]) -> int:
    """Return the command's exit code; 2 when no container can be started."""
    if reason := missing():
        sys.stderr.write(f"tools.nspawn: {reason}\n")
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with Machine() as machine:
        if command:
            done = machine.run(*command, check=False, timeout_s=3600)
            sys.stdout.write(done.stdout)
            sys.stderr.write(done.stderr)
            return done.returncode
        sys.stdout.write(f"booted; a shell inside: nsenter --target={machine.leader} --all -- bash --login\n")
        sys.stdout.flush()
        signal.pause()
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
