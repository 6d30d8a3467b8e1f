"""The window's process in its parent: its socket, its error output and its end."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess

from drivers.child_process import end, environment, interpreter

MODULE = "drivers.projector.window_process.child"
KEPT_BYTES = 2000


class WindowProcess:
    """A process with the projector's window, started by the constructor.

    It ends with the thread that created it (by the kernel's signal), which must therefore be the supervising one.
    """

    def __init__(self) -> None:
        self.sock, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - this program, fixed arguments
                [*interpreter(), "-m", MODULE, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                process_group=0,
            )
        assert self._process.stderr is not None  # noqa: S101 - for the type checker
        self.stderr = self._process.stderr
        os.set_blocking(self.stderr.fileno(), False)
        self._output = b""

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def listen(self) -> bool:
        """Read its error output and keep the end; return whether more may come."""
        try:
            piece = os.read(self.stderr.fileno(), 65536)
        except BlockingIOError:
            return True
        self._output = (self._output + piece)[-KEPT_BYTES:]
        return bool(piece)

    def end(self, timeout_s: float) -> str:
        """Wait for its end, kill it after ``timeout_s``; return its last line of output, or how it ended."""
        status = end(self._process, timeout_s)
        with contextlib.suppress(OSError):
            self.listen()
        self.stderr.close()
        self.sock.close()
        lines = self._output.decode(errors="replace").strip().splitlines()
        ending = f"signal {-status}" if status < 0 else f"exit status {status}"
        return f"{lines[-1][:300]} ({ending})" if lines else ending

    def kill(self) -> None:
        """Kill it."""
        self._process.kill()
