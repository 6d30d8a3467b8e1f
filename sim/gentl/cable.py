"""The world's side of an emulated camera: light on its sensor, edges on its trigger lines, plugging and unplugging."""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Callable
from fcntl import F_OFD_GETLK, F_UNLCK, F_WRLCK, fcntl
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np

from sim.gentl import memory
from sim.gentl.counters import CableState, read_state
from sim.gentl.shared_images import Image, Images

Filter = Literal["mono", "RG", "GR", "GB", "BG"]
_FLOCK = "hhqqi4x"
_WAKE = struct.pack("<Q", memory.WAKE_MAGIC)
"""No pulse: makes the camera's process read its state at once."""
_POLL_S = 0.00005
_TIMEOUT_S = 1.0


class Cable:
    """One emulated camera, seen from the world; it starts plugged in.

    ``show``, ``pulse`` and ``close`` belong to one thread; faults, waits and ``state`` may come from another.

    Args:
        directory: FRINGED_GENTL_DIR of the camera's process; number: 0 to 7, each once.
        serial, model: that it reports, at most 63 bytes.
        size: (width, height) of the sensor, multiples of 4 and 2, at least 16 x 4.
        sensor: its colour filter; ``mono`` has none and offers no colour format.
        old: an older model: features by the names of GigE Vision's first version, clock in ticks of 8 ns, no chunks.
        automatic: at power-on exposure, gain and white balance are automatic, gamma and the frame rate's limit are on.
        real_time: frames leave the camera exposure and readout after the pulse; otherwise at once, for lock-step.
        readout_us: least time between two exposures and from an exposure's end to the frame.
        exposure_step_us: exposure times are whole multiples of it.
        reference_exposure_us: exposure time with which the camera returns the values of the image shown, others
            make it darker or brighter; 0: the exposure time has no effect.

    Raises:
        ValueError: an impossible size, name or number; the message gives the limits.
        FileExistsError: the number is taken in this directory.
    """

    def __init__(
        self,
        directory: Path,
        number: int,
        *,
        serial: str,
        model: str = "FringedCam",
        size: tuple[int, int] = (640, 480),
        sensor: Filter = "RG",
        old: bool = False,
        automatic: bool = False,
        real_time: bool = True,
        readout_us: float = 2000.0,
        exposure_step_us: float = 0.5,
        reference_exposure_us: float = 0.0,
    ) -> None:
        _check(number, size, serial, model)
        self.number, self.serial, self.size = number, serial, size
        self._paths = {ending: directory / f"cam{number}.{ending}" for ending in ("state", "img", "sock")}
        if len(os.fsencode(self._paths["sock"])) > 107:
            raise ValueError(f"the path {self._paths['sock']} is longer than the 107 bytes of a socket's name")
        self._images = Images(self._paths["img"], size)
        values: dict[str, int | float | bytes] = {
            "width": size[0],
            "height": size[1],
            "filter": memory.FILTERS.index(sensor),
            "variant": int(old),
            "automatic": int(automatic),
            "reference_exposure_ns": round(reference_exposure_us * 1e3),
            "real_time": int(real_time),
            "readout_ns": round(readout_us * 1e3),
            "exposure_step_ns": round(exposure_step_us * 1e3),
            "temperature_c": 38.5,
            "serial": serial.encode(),
            "model": model.encode(),
            "clock_base_ns": time.monotonic_ns(),
            "power_cycles": 1,
            "present": 1,
            "magic": memory.STATE_MAGIC,
        }
        self._state = self._publish(values)
        self._socket: socket.socket | None = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def show(self, image: Image) -> int:
        """Expose the whole sensor to an image, and return the image's number from 1.

        Args:
            image: (H, W) or (H, W, 3) of the sensor's size, uint8 or uint16 over their whole range.
        """
        self._live()
        return self._images.show(image)

    def pulse(self, t_ns: int | None = None, *, line: int = 1, width_ns: int = 10_000) -> bool:
        """Give a pulse on a line; the image exposed is the one shown now.

        Args:
            t_ns: CLOCK_MONOTONIC time of the rising edge, may lie in the future; None: now. Without real time,
                a pulse without a time never comes during an exposure; one with a time may.
            line: 0, 1 or 2; width_ns: falling edge after the rising one.

        Returns:
            Whether a process has the camera open and accepted the pulse, so that it will be acknowledged. False after
            a second in which that process accepted none, or had 60 future pulses already.
        """
        state = self._live()
        if not state["present"] or not state["owner_pid"]:
            return False
        busy_check = t_ns is not None or bool(state["real_time"])
        t_ns = time.monotonic_ns() if t_ns is None else t_ns
        requested = int(state["requested"]) + 1
        pulse = (memory.PULSE_MAGIC, requested, t_ns, width_ns, line, self._images.shown, busy_check)
        message = np.array([pulse], dtype=memory.PULSE_DTYPE).tobytes()
        deadline = time.monotonic() + _TIMEOUT_S
        while requested - int(state["acknowledged"]) > memory.MAX_PENDING or not self._send(message):
            if not self._holder() or time.monotonic() > deadline:
                return False
            time.sleep(_POLL_S)
        state["requested"] = requested
        return True

    def drop(self, count: int = 1) -> None:
        """Lose the next frames that leave the camera: each leaves a gap in the frame numbers."""
        self._request("drops_requested", "dropped", count)

    def truncate(self, count: int = 1) -> None:
        """Lose the second half of the next frames that leave the camera."""
        self._request("truncations_requested", "truncated", count)

    def stall(self, seconds: float) -> None:
        """Hold all frames in the camera's memory for so long from now on, 0 to release them; it has room for 8."""
        self._live()["stall_until_ns"] = time.monotonic_ns() + round(seconds * 1e9)
        self._send(_WAKE)

    def unplug(self) -> None:
        """Unplug the camera: register access fails with an input/output error, and it leaves the list."""
        self._live()["present"] = 0
        self._send(_WAKE)

    def plug(self) -> None:
        """Plug in again: a new power-on, with registers at their defaults and the clock at 0."""
        state = self._live()
        if state["present"]:
            return
        state["power_cycles"] = int(state["power_cycles"]) + 1
        self._write_clock(offset_ns=0, drift_ppb=int(state["clock_drift_ppb"]))
        state["present"] = 1
        self._send(_WAKE)

    def set_temperature(self, celsius: float) -> None:
        """Set the camera's temperature."""
        self._live()["temperature_c"] = celsius

    def set_clock(self, offset_ns: int = 0, drift_ppm: float = 0.0) -> None:
        """Set the camera's clock to ``offset_ns`` now, running ``drift_ppm`` fast from now on."""
        self._write_clock(offset_ns=offset_ns, drift_ppb=round(drift_ppm * 1000))

    def device_ns(self, t_ns: int) -> int:
        """The camera's clock at a time of CLOCK_MONOTONIC, to the nanosecond."""
        state = self._live()
        since = t_ns - int(state["clock_base_ns"])
        return int(state["clock_offset_ns"]) + since + since * int(state["clock_drift_ppb"]) // 10**9

    def state(self) -> CableState:
        """State and counters of the camera."""
        return read_state(self._live(), self._holder())

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until every pulse is acknowledged and every frame has left the camera, or no process has it open."""
        state = self._live()

        def idle() -> bool:
            if state["acknowledged"] == state["requested"] and not state["inside"]:
                return True
            return not self._holder()

        return _wait(idle, timeout_s)

    def wait_delivered(self, count: int, timeout_s: float) -> bool:
        """Wait until so many whole frames were delivered since the cable was made."""
        state = self._live()
        return _wait(lambda: bool(state["delivered"] >= count), timeout_s)

    def wait_armed(self, timeout_s: float) -> bool:
        """Wait until the next pulse on the right line would start an exposure."""
        state = self._live()
        return _wait(lambda: bool(state["armed"]), timeout_s)

    def close(self) -> None:
        """Unplug for good and remove the files; may be called twice."""
        if self._socket is None:
            return
        self.unplug()
        self._socket.close()
        self._socket = None
        for path in self._paths.values():
            path.unlink(missing_ok=True)

    def _publish(self, values: dict[str, int | float | bytes]) -> np.void:
        """Write the state under a temporary name first, so that no process maps a part of it."""
        temporary = self._paths["state"].with_suffix(".making")
        shared = memory.create_shared(temporary, (memory.STATE_DTYPE.itemsize + 7) // 8 * 8)
        state: np.void = shared[: memory.STATE_DTYPE.itemsize].view(memory.STATE_DTYPE)[0]
        for name, value in values.items():
            state[name] = value
        temporary.rename(self._paths["state"])
        return state

    def _live(self) -> np.void:
        if self._socket is None:
            raise ValueError(f"the cable of camera {self.serial} is closed")
        return self._state

    def _request(self, requested: str, done: str, count: int) -> None:
        state = self._live()
        state[requested] = max(int(state[requested]), int(state[done])) + count

    def _send(self, message: bytes) -> bool:
        """Send a datagram; whether the camera's process received it: its queue is short."""
        assert self._socket is not None  # noqa: S101 - for the types; _live has checked it
        try:
            self._socket.sendto(message, str(self._paths["sock"]))
        except (FileNotFoundError, ConnectionRefusedError, BlockingIOError):
            return False
        return True

    def _write_clock(self, *, offset_ns: int, drift_ppb: int) -> None:
        state = self._live()
        state["clock_sequence"] = int(state["clock_sequence"]) + 1
        state["clock_base_ns"], state["clock_offset_ns"] = time.monotonic_ns(), offset_ns
        state["clock_drift_ppb"] = drift_ppb
        state["clock_sequence"] = int(state["clock_sequence"]) + 1

    def _holder(self) -> int:
        """Pid of the process that has the camera open: the lock ends with the process, the written pid may stay."""
        with self._paths["state"].open("rb") as file:
            request = struct.pack(_FLOCK, F_WRLCK, os.SEEK_SET, 0, 0, 0)
            kind = struct.unpack(_FLOCK, fcntl(file.fileno(), F_OFD_GETLK, request))[0]
        return 0 if kind == F_UNLCK else int(self._live()["owner_pid"])


def _check(number: int, size: tuple[int, int], serial: str, model: str) -> None:
    if not 0 <= number < memory.MAX_CAMERAS:
        raise ValueError(f"camera number {number} is not 0 .. {memory.MAX_CAMERAS - 1}")
    width, height = size
    most = memory.MAX_SIDE
    if width % 4 or height % 2 or not 16 <= width <= most or not 4 <= height <= most:
        raise ValueError(f"sensor of {width} x {height} pixels: multiples of 4 and 2 from 16 x 4 to {most} x {most}")
    for name in serial, model:
        if not 0 < len(name.encode()) < 64:
            raise ValueError(f"{name!r} as serial number or model: 1 to 63 bytes")


def _wait(condition: Callable[[], bool], timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(_POLL_S)
    return True
