"""An X server without hardware: the dummy driver with any number of RandR outputs of any size, or Xvfb.

The dummy driver gives real RandR outputs (``DUMMY0``, ``DUMMY1``, ...) with modes, positions and gamma tables, and a
vertical blank at 60 Hz. Nothing is drawn by a graphics card: OpenGL runs on the processor (llvmpipe).
"""

from __future__ import annotations

import math
import os
import secrets
import selectors
import shutil
import signal
import subprocess
import tempfile
import time
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal

PACKAGES = "xserver-xorg-core xserver-xorg-video-dummy xvfb libgl1-mesa-dri"
LOG_TAIL_BYTES = 4000
STOP_S = 5.0
FIRST_DISPLAY, DISPLAYS = 100, 900

SERVER_FLAGS = """\
Section "ServerFlags"
  Option "AutoAddDevices" "false"
  Option "AutoEnableDevices" "false"
  Option "AutoAddGPU" "false"
  Option "DontVTSwitch" "true"
  Option "BlankTime" "0"
EndSection
Section "Device"
  Identifier "dummy"
  Driver "dummy"
  VideoRam {video_ram_kb}
{outputs}EndSection
Section "Monitor"
  Identifier "any"
  HorizSync 1-5000
  VertRefresh 1-1000
EndSection
{monitors}Section "Screen"
  Identifier "screen"
  Device "dummy"
  Monitor "any"
  DefaultDepth 24
  SubSection "Display"
    Depth 24
    Virtual {virtual[0]} {virtual[1]}
  EndSubSection
EndSection
"""

MONITOR = """\
Section "Monitor"
  Identifier "{name}"
  HorizSync 1-5000
  VertRefresh 1-1000
  {modeline}
  Option "PreferredMode" "{mode}"
  Option "Position" "{x} 0"
  Option "Enable" "true"
EndSection
"""


def _free_display() -> str:
    """An unused display number.

    Not the lowest one, which any other server would take while this one restarts.
    """
    while True:
        number = FIRST_DISPLAY + secrets.randbelow(DISPLAYS)
        if not any(Path(place).exists() for place in (f"/tmp/.X{number}-lock", f"/tmp/.X11-unix/X{number}")):  # noqa: S108
            return f":{number}"


class XServerError(RuntimeError):
    """The X server did not start; the message ends with its log."""


@dataclass(frozen=True, slots=True)
class Head:
    """One output of the server: (width, height) of its mode in pixels, and its refresh rate as RandR reports it.

    The dummy driver's vertical blank is at 60 Hz in any mode.
    """

    width: int
    height: int
    refresh_hz: float = 60.0

    def __post_init__(self) -> None:
        if not (64 <= self.width <= 4096 and 64 <= self.height <= 4096):
            raise ValueError(f"head {self.width}x{self.height}: expected 64 to 4096 pixels each way")
        if self.width % 8:
            raise ValueError(f"head {self.width}x{self.height}: X modes have widths that are multiples of 8")

    @property
    def mode(self) -> str:
        """Name of its mode in RandR, different from those of the driver's modes."""
        return f"{self.width}x{self.height}_{self.refresh_hz:g}"

    @property
    def modeline(self) -> str:
        """Its timings, with blanking intervals that the server accepts."""
        columns, rows = self.width + 160, self.height + 30
        clock_mhz = columns * rows * self.refresh_hz / 1e6
        across = f"{self.width} {self.width + 48} {self.width + 80} {columns}"
        down = f"{self.height} {self.height + 3} {self.height + 9} {rows}"
        return f'Modeline "{self.mode}" {clock_mhz:.3f} {across} {down}'


DESKTOP_AND_PROJECTOR = Head(1280, 720), Head(1280, 1024)


class XServer:
    """An X server of this process.

    ``DUMMY0`` is at the left, each further output right of the one before. The display number is a free one;
    :meth:`restart` keeps it. All its files lie in a private temporary directory. It ends with the thread that started
    it.

    Args:
        heads: the outputs, left to right.
        kind: ``dummy`` = Xorg with the dummy driver; ``xvfb`` = Xvfb, which has one output called ``screen``.
        timeout_s: how long a start may take.

    Raises:
        XServerError: from :meth:`start`: the program is missing, or it ended or hung; with the end of its log.
    """

    def __init__(
        self,
        heads: Sequence[Head] = DESKTOP_AND_PROJECTOR,
        *,
        kind: Literal["dummy", "xvfb"] = "dummy",
        timeout_s: float = 20.0,
    ) -> None:
        if not heads or (kind == "xvfb" and len(heads) != 1):
            raise ValueError(f"{len(heads)} heads: expected one for xvfb, at least one for dummy")
        self.heads = tuple(heads)
        self.display = ""
        self._kind = kind
        self._timeout_s = timeout_s
        self._server: subprocess.Popen[bytes] | None = None
        self._directory: tempfile.TemporaryDirectory[str] | None = None
        self._finalizer: weakref.finalize[[subprocess.Popen[bytes]], XServer] | None = None

    def __enter__(self) -> XServer:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """Process id of the running server."""
        if self._server is None:
            raise XServerError("the X server is not running")
        return self._server.pid

    @property
    def alive(self) -> bool:
        """Whether the server runs at this moment."""
        return self._server is not None and self._server.poll() is None

    def environment(self) -> dict[str, str]:
        """This process's environment with DISPLAY set to the server."""
        without = {k: v for k, v in os.environ.items() if k not in ("WAYLAND_DISPLAY", "XAUTHORITY")}
        return {**without, "DISPLAY": self.display}

    def start(self) -> None:
        """Start, and wait until it accepts connections; does nothing when it runs."""
        if self.alive:
            return
        self.stop()
        self._directory = tempfile.TemporaryDirectory(prefix="fringed-x-", ignore_cleanup_errors=True)
        try:
            self._launch(Path(self._directory.name))
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """End and reap the server and remove what it wrote; may be called twice."""
        if self._finalizer is not None:
            self._finalizer()
            self._finalizer = None
        self._server = None
        if self._directory is not None:
            self._directory.cleanup()
            self._directory = None

    def kill(self) -> None:
        """Kill the server, as in a crash; its clients see a broken connection."""
        if self._server is not None:
            self._server.kill()
            self._server.wait()

    def restart(self) -> None:
        """Stop, and start under the same display number."""
        self.stop()
        self.start()

    def log(self) -> str:
        """The end of the server's log."""
        if self._directory is None:
            return ""
        output = []
        for name in ("stderr", "log"):
            path = Path(self._directory.name, name)
            if path.exists():
                output.append(path.read_text(errors="replace")[-LOG_TAIL_BYTES:])
        return "\n".join(output).strip()

    def _launch(self, directory: Path) -> None:
        ready, write = os.pipe()
        try:
            with (directory / "stderr").open("wb") as stderr:
                self._server = subprocess.Popen(  # noqa: S603 - a fixed argument list, no shell
                    self._command(directory, write),
                    pass_fds=(write,),
                    stdin=subprocess.DEVNULL,
                    stdout=stderr,
                    stderr=stderr,
                    cwd=directory,
                )
            self._finalizer = weakref.finalize(self, _end, self._server)
            os.close(write)
            write = -1
            self.display = f":{self._wait_ready(ready)}"
        finally:
            os.close(ready)
            if write >= 0:
                os.close(write)

    def _command(self, directory: Path, ready: int) -> list[str]:
        program = shutil.which("Xorg" if self._kind == "dummy" else "Xvfb")
        if program is None:
            raise XServerError(f"no {self._kind} X server is installed; install the packages {PACKAGES}")
        guard = shutil.which("setpriv")
        command = [guard, "--pdeathsig", "KILL", program] if guard else [program]
        command += [self.display or _free_display(), "-displayfd", str(ready)]
        command += ["-s", "0", "-noreset", "-nolisten", "tcp"]
        if self._kind == "xvfb":
            head = self.heads[0]
            return [*command, "-screen", "0", f"{head.width}x{head.height}x24"]
        (directory / "xorg.conf").write_text(configuration(self.heads))
        (directory / "conf.d").mkdir()
        files = ["-config", str(directory / "xorg.conf"), "-configdir", str(directory / "conf.d")]
        return [*command, "-nocursor", *files, "-logfile", str(directory / "log"), "-novtswitch", "-sharevts"]

    def _wait_ready(self, ready: int) -> int:
        assert self._server is not None  # noqa: S101 - for the type checker
        deadline = time.monotonic() + self._timeout_s
        output = b""
        with selectors.DefaultSelector() as selector:
            selector.register(ready, selectors.EVENT_READ)
            while not output.endswith(b"\n"):
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise XServerError(f"the X server accepted no connection within {self._timeout_s} s\n{self.log()}")
                piece = os.read(ready, 64)
                if not piece:
                    code = self._server.wait(STOP_S)
                    raise XServerError(f"the X server ended with {code} while starting\n{self.log()}")
                output += piece
        return int(output)


def configuration(heads: Sequence[Head]) -> str:
    """An xorg.conf for the dummy driver with these outputs side by side; the driver adds modes like 640x480."""
    width, height = sum(head.width for head in heads), max(head.height for head in heads)
    virtual = max(4096, width), max(2304, height)
    monitors, x = [], 0
    for number, head in enumerate(heads):
        monitors.append(MONITOR.format(name=f"monitor{number}", modeline=head.modeline, mode=head.mode, x=x))
        x += head.width
    return SERVER_FLAGS.format(
        video_ram_kb=math.ceil(virtual[0] * virtual[1] * 4 / 1024 * 1.1),
        outputs="".join(f'  Option "Monitor-DUMMY{n}" "monitor{n}"\n' for n in range(len(heads))),
        monitors="".join(monitors),
        virtual=virtual,
    )


def _end(server: subprocess.Popen[bytes]) -> None:
    if server.poll() is None:
        server.send_signal(signal.SIGTERM)
        try:
            server.wait(STOP_S)
        except subprocess.TimeoutExpired:
            server.kill()
    server.wait()
