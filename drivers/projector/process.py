"""The window's process as its parent sees it: a socket, what it prints, and its end."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys

from drivers.projector.listing import module_environment

MODULE = "drivers.projector.child"
SAID_BYTES = 2000


class WindowProcess:
    """A process with the projector's window, started at once.

    It ends with the thread that made it (the kernel tells it), so that thread must be the one that watches it.
    """

    def __init__(self) -> None:
        self.sock, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - this program, fixed arguments
                [sys.executable, "-m", MODULE, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                env=module_environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                process_group=0,
            )
        assert self._process.stderr is not None  # noqa: S101 - for the type checker
        self.stderr = self._process.stderr
        os.set_blocking(self.stderr.fileno(), False)
        self._said = b""

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def listen(self) -> bool:
        """Keep the end of what it printed; whether it may print more."""
        try:
            piece = os.read(self.stderr.fileno(), 65536)
        except BlockingIOError:
            return True
        self._said = (self._said + piece)[-SAID_BYTES:]
        return bool(piece)

    def end(self, patience_s: float) -> str:
        """Wait for its end, kill it after ``patience_s``; the last thing that it printed, or how it ended."""
        try:
            status = self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        with contextlib.suppress(OSError):
            self.listen()
        self.stderr.close()
        self.sock.close()
        lines = self._said.decode(errors="replace").strip().splitlines()
        how = f"signal {-status}" if status < 0 else f"exit status {status}"
        return f"{lines[-1][:300]} ({how})" if lines else how

    def kill(self) -> None:
        """End it without warning."""
        self._process.kill()
