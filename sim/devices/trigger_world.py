"""The world around the simulated devices: triggers, exposures and faults."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import SIDES, TRIGGER_MODULUS, Clock, Frame, Side
from sim.devices.camera import SimCamera
from sim.devices.clock import SystemClock
from sim.devices.faults import Fault, FaultKind, FaultPlan, Ledger

Image = NDArray[np.uint8] | NDArray[np.uint16]


class Images(Protocol):
    """Source of the images of a trigger; they are read-only."""

    def pair(self, index: int) -> tuple[Image, Image]:
        """Left and right image of trigger ``index``."""


class Lamp(Protocol):
    """The part of the simulated projector that the world uses."""

    @property
    def lit(self) -> bool:
        """Whether the projector shows its image; otherwise dark images are sent."""

    def close(self) -> None:
        """Show black and disconnect."""


class SimWorld:
    """Triggers the cameras and delivers their frames, subject to the fault plan.

    :meth:`step` triggers once and returns when all frames have arrived, so tests need no clock. With ``rate_hz`` above
    0 a thread triggers in real time, from the start of the first camera until :meth:`close`.

    Args:
        images: of each trigger.
        projector: dark images are sent while it is dark.
        size: (width, height) of the cameras.
        plan: of faults.
        rate_hz: triggers a second; 0 = only by :meth:`step`.
        clock: the machine's if None.
        first_number: number of the first trigger; it wraps at 2**32.
        exposure_us: exposure time, after which a frame arrives.
        dark_dn: counts of an image without projector light.
        queue_frames: capacity of each camera's queue.
        keep_entries: whether the ledger keeps every event, not only counts.
        note: on the images, for the cameras' information.
    """

    _slack = 1.0  # Fraction of a period by which a late trigger may shorten the time to the next one.

    def __init__(
        self,
        images: Images,
        projector: Lamp,
        size: tuple[int, int],
        encoding: str,
        *,
        plan: FaultPlan | None = None,
        rate_hz: float = 0.0,
        clock: Clock | None = None,
        first_number: int = 0,
        exposure_us: float = 8_000.0,
        dark_dn: float = 4.0,
        queue_frames: int = 8,
        keep_entries: bool = False,
        note: str = "simulated: images come from a rendered loop",
    ) -> None:
        self._images, self._projector, self._encoding = images, projector, encoding
        self._plan, self._rate_hz, self._clock = plan or FaultPlan.none(), rate_hz, clock or SystemClock()
        self._first_number, self._exposure_us, self._dark_dn = first_number, exposure_us, dark_dn
        self.ledger = Ledger(keep_entries=keep_entries)
        self.cameras: dict[Side, SimCamera] = {
            side: SimCamera(
                side,
                size,
                encoding,
                queue_frames=queue_frames,
                dropped=self._note_dropped,
                started=self._wake,
                note=note,
            )
            for side in SIDES
        }
        self._index = 0
        self._late: list[tuple[int, int, Frame]] = []
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._dark: Image | None = None

    @property
    def triggers(self) -> int:
        """Number of triggers so far."""
        return self._index

    @property
    def pending(self) -> int:
        """Number of late frames not yet delivered."""
        return len(self._late)

    def step(self) -> int:
        """Trigger once; returns the trigger's number."""
        with self._lock:
            index = self._index
            t_ns = self._clock.realtime_ns() - round(1000 * self._exposure_us)
            if index == 0:
                self._send_extras(t_ns)
            pair = self._exposed(index)
            for side, image in zip(SIDES, pair, strict=True):
                self._expose(index, side, image, t_ns)
            self._send_late(index)
            self._index += 1
            return self._number(index)

    def flush(self) -> None:
        """Deliver all late frames."""
        with self._lock:
            self._send_late(self._index + TRIGGER_MODULUS)

    def start(self) -> None:
        """Trigger in real time; does nothing when ``rate_hz`` is 0 or the thread runs."""
        with self._lock:
            if self._rate_hz <= 0 or self._thread is not None:
                return
            self._stop.clear()
            self._thread = threading.Thread(target=self._run, name="sim-trigger", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop triggering in real time."""
        with self._lock:
            thread, self._thread = self._thread, None
            self._stop.set()
        if thread is not None and thread is not threading.current_thread():
            thread.join(timeout=5.0)

    def close(self) -> None:
        """Stop, and close all devices."""
        self.stop()
        for camera in self.cameras.values():
            camera.close()
        self._projector.close()

    def _wake(self) -> None:
        self.start()

    def _run(self) -> None:
        period_ns = round(1e9 / self._rate_hz)
        slack_ns = round(self._slack * period_ns)
        due_ns = self._clock.monotonic_ns() + period_ns
        while not self._stop.wait(max(0, due_ns - self._clock.monotonic_ns()) / 1e9):
            self.step()
            # After a suspension of the machine triggering continues from now, without all missed triggers at once.
            due_ns = max(due_ns, self._clock.monotonic_ns() - slack_ns) + period_ns

    def _number(self, index: int, off: int = 0) -> int:
        return (self._first_number + index + off) % TRIGGER_MODULUS

    def _exposed(self, index: int) -> tuple[Image, Image]:
        left, right = self._images.pair(index)
        if self._projector.lit:
            return left, right
        if self._dark is None:
            level = round(self._dark_dn * (257 if left.dtype == np.uint16 else 1))
            self._dark = np.full(left.shape, level, left.dtype)
            self._dark.setflags(write=False)
        return self._dark, self._dark

    def _frame(self, index: int, side: Side, image: Image, t_ns: int, off: int = 0) -> Frame:
        # Both cameras share a trigger line: their times differ by a few hundred nanoseconds.
        jitter_ns = (index * 7919 + (523 if side == "right" else 0)) % 1000 - 500
        number, now_ns = self._number(index, off), self._clock.realtime_ns()
        return Frame(side, number, t_ns + jitter_ns, now_ns, self._encoding, image, self._exposure_us)

    def _expose(self, index: int, side: Side, image: Image, t_ns: int) -> None:
        fault = self._plan.of(index, side)
        self.cameras[side].set_present(fault.kind is not FaultKind.GONE)
        if fault.kind in (FaultKind.LOST, FaultKind.BLACKOUT, FaultKind.GONE):
            self.ledger.note(index, self._number(index), side, fault.kind)
            return
        frame = self._frame(index, side, image, t_ns, fault.length if fault.kind is FaultKind.WRONG_NUMBER else 0)
        if fault.kind is FaultKind.LATE:
            self._postpone(index, fault, frame)
            return
        if fault.kind is not FaultKind.NONE:
            self.ledger.note(index, frame.trigger, side, fault.kind)
        self._deliver(index, frame)
        if fault.kind is FaultKind.DUPLICATE:
            self._deliver(index, frame)

    def _postpone(self, index: int, fault: Fault, frame: Frame) -> None:
        self.ledger.note(index, frame.trigger, frame.side, fault.kind)
        self._late.append((index + fault.length, index, frame))

    def _send_late(self, index: int) -> None:
        due = [item for item in self._late if item[0] <= index]
        self._late = [item for item in self._late if item[0] > index]
        for _, first, frame in due:
            self._deliver(first, replace(frame, t_host_ns=self._clock.realtime_ns()))

    def _send_extras(self, t_ns: int) -> None:
        """A frame that a camera exposed before the first trigger, carrying the number before it."""
        period_ns = round(1e9 / self._rate_hz) if self._rate_hz > 0 else 100_000_000
        for side, image in zip(SIDES, self._exposed(0), strict=True):
            if self._plan.extra_first(side):
                frame = self._frame(-1, side, image, t_ns - period_ns)
                self.ledger.note(-1, frame.trigger, side, FaultKind.EXTRA_FIRST)
                self._deliver(-1, frame)

    def _deliver(self, index: int, frame: Frame) -> None:
        accepted = self.cameras[frame.side].deliver(frame)
        self.ledger.note(index, frame.trigger, frame.side, "sent" if accepted else "not_listening")

    def _note_dropped(self, frame: Frame, why: str) -> None:
        self.ledger.note(-1, frame.trigger, frame.side, why)
