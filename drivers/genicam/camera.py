"""A GenICam camera in this process; see :func:`drivers.genicam.open_camera` for the one in a process of its own."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import DeviceLost, DriverError
from drivers.genicam import formats
from drivers.genicam.connection import Connection
from drivers.genicam.features import GENICAM_ERRORS, Features, losses
from drivers.genicam.numbering import TriggerNumbers
from drivers.genicam.options import Options, parse, producers
from drivers.genicam.setup import CameraSetup, Setup
from drivers.genicam.timing import Timing
from drivers.host_clocks import Clocks
from drivers.protocols import CameraHealth, CameraInfo, Frame, Side

log = logging.getLogger(__name__)

_POLL_S = 0.0005
_LOOK_NS = 1_000_000_000


@dataclass(slots=True, eq=False)
class _Open:
    """What belongs to one opening of the camera."""

    connection: Connection
    setup: Setup
    timing: Timing
    numbers: TriggerNumbers


class GenicamCamera:
    """Implements :class:`drivers.protocols.Camera` through harvesters.

    Args:
        producer_paths: .cti files. wait_ms: how long to wait inside the producer, where Python's lock is held; 0 polls
            twice a millisecond instead, for processes that have other things to do.

    Attributes:
        allocate: gives the memory of an image; a process that shares its images puts its own here.
    """

    def __init__(self, side: Side, options: Options, producer_paths: list[Path], *, wait_ms: int = 0) -> None:
        self.side = side
        self.allocate: Callable[..., Any] = np.empty
        self._options, self._producers, self._wait_ms = options, producer_paths, wait_ms
        self._open: _Open | None = None
        self._acquiring = False
        self._counters = {"incomplete": 0, "no_buffer": 0, "missed_trigger": 0, "lost": 0, "wrong_format": 0}
        self._seen: dict[str, int] = {}
        self._temperature_c: float | None = None
        self._heard_ns = self._look_ns = self._fire_ns = 0
        self._known_before = self._lost_in_run = 0

    def open(self) -> CameraInfo:
        """Connect and set up.

        Raises:
            DeviceLost: no such camera, or it is in use. SettingRefused: it cannot measure as asked.
        """
        self.close()
        connection = Connection(self._producers, self._options, wait_ms=self._wait_ms)
        try:
            with losses("setting it up"):
                setup = CameraSetup(connection.camera, connection.stream, self._options).run()
                timing = Timing(connection.camera, offset_us=self._options.timestamp_offset_us)
        except GENICAM_ERRORS as error:
            connection.close()
            raise DriverError(f"{connection.found.model} cannot be set up: {error}") from error
        except BaseException:
            connection.close()
            raise
        numbers = TriggerNumbers(1 if connection.found.transport == "GEV" else 0)
        self._open = _Open(connection, setup, timing, numbers)
        self._seen = {}
        self._look(self._open)
        notes = list(setup.notes)
        if not timing.latches:
            notes.append("this camera does not tell its time; exposure times follow the earliest arrivals")
        return CameraInfo(
            connection.found.model,
            connection.found.serial,
            setup.size,
            setup.pixels.encoding,
            setup.exposure_us,
            tuple(notes),
        )

    def start(self) -> None:
        """Begin to accept triggers."""
        now = self._now()
        now.numbers.start()
        now.timing.follow(time.monotonic_ns())
        now.connection.start()
        self._known_before, self._lost_in_run = self._unexplained(now), 0
        self._acquiring = True
        self._heard_ns = time.monotonic_ns()

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame, None when none came in time; DeviceLost when the camera does not answer any more."""
        now = self._now()
        end = time.monotonic() + timeout_s
        while True:
            self._keep_up(now)
            buffer = now.connection.fetch()
            if buffer is not None:
                try:
                    frame = self._frame(now, buffer, Clocks.now())
                finally:
                    now.connection.requeue(buffer)
                self._heard_ns = time.monotonic_ns()
                if frame is not None:
                    return frame
            if time.monotonic() >= end:
                return None
            if buffer is None and not self._wait_ms:
                time.sleep(_POLL_S)

    def stop(self) -> None:
        """Stop accepting triggers; frames not yet read are dropped."""
        if self._open is not None and self._acquiring:
            self._acquiring = False
            self._open.connection.stop()

    def close(self) -> None:
        """Let go of the camera; never raises."""
        if self._open is not None:
            self._open.connection.close()
            self._open = None
        self._acquiring = False

    def health(self) -> CameraHealth:
        """As of about a second ago."""
        return CameraHealth(self._temperature_c, dict(self._counters))

    def _now(self) -> _Open:
        if self._open is None:
            raise DeviceLost(f"the {self.side} camera is not open")
        return self._open

    def _frame(self, now: _Open, buffer: Any, clocks: Clocks) -> Frame | None:
        """The frame in a buffer, copied out of it; None for what is no image as agreed."""
        setup, camera = now.setup, now.connection.camera
        width, height = setup.size
        asked = _Asked(buffer)
        code, size = asked.number("pixel_format"), (asked.number("width"), asked.number("height"))
        pixels = formats.BY_CODE.get(code, setup.pixels) if code is not None else setup.pixels
        if pixels.encoding != setup.pixels.encoding or size not in (setup.size, (None, None)):
            self._refuse(f"an image of {size} {pixels.name} came instead of {setup.size} {setup.pixels.name}")
            return None
        start = asked.number("image_offset") or 0
        filled = asked.number("size_filled")
        raw = np.frombuffer(buffer.raw_buffer, np.uint8)
        image = self.allocate(pixels.frame_shape(width, height), pixels.dtype)
        try:
            formats.convert(
                raw[start : filled or raw.size], pixels, width, height, image, padding=asked.number("padding_x") or 0
            )
        except ValueError as error:
            self._refuse(str(error))
            return None
        image.flags.writeable = False
        exposure_us = _exposure_us(camera, asked) or setup.exposure_us
        when = now.timing.exposure(buffer, clocks.monotonic_ns, exposure_us)
        frame_id = asked.number("frame_id")
        if frame_id is None:
            found = camera.read("ChunkFrameID")
            frame_id = None if found is None else int(found)
        stamp = when.t_ns if when.t_device_ns is None else when.t_device_ns
        trigger = self._number(now, frame_id, stamp)
        return Frame(
            side=self.side,
            trigger=trigger,
            t_exposure_ns=clocks.to_realtime_ns(when.t_ns),
            t_host_ns=clocks.realtime_ns,
            encoding=setup.pixels.encoding,
            image=image,
            exposure_us=exposure_us,
            t_device_ns=when.t_device_ns,
            frame_id=frame_id,
        )

    def _number(self, now: _Open, frame_id: int | None, stamp_ns: int) -> int:
        """The trigger; gaps that no other counter explains are counted as lost."""
        numbers = now.numbers
        before, by_time = numbers.gaps, numbers.by_time
        trigger = numbers.number(frame_id, stamp_ns)
        if numbers.by_time and not by_time:
            log.warning("the camera's frame numbers do not count (%s); frames are numbered by time", frame_id)
        self._counters["numbered_by_time"] = self._counters.get("numbered_by_time", 0) + numbers.by_time
        if numbers.gaps > before:
            self._count_losses(now)
            unexplained = self._unexplained(now) - self._known_before
            self._counters["lost"] += max(unexplained - self._lost_in_run, 0)
            self._lost_in_run = max(unexplained, self._lost_in_run)
        return trigger

    def _unexplained(self, now: _Open) -> int:
        """Frames that the camera counted, never came, and no other counter tells of."""
        return now.numbers.gaps - self._counters["incomplete"] - self._counters["no_buffer"]

    def _count_losses(self, now: _Open) -> None:
        """Bring the counters of frames that came to nothing on their way up to date."""
        self._grow("incomplete", now.connection.incomplete)
        self._grow("no_buffer", now.connection.underruns())

    def _grow(self, name: str, reading: int) -> None:
        """Add what a counter of the camera grew by; one that went back began anew."""
        before = self._seen.get(name, 0)
        self._counters[name] += reading - before if reading >= before else reading
        self._seen[name] = reading

    def _refuse(self, why: str) -> None:
        if self._counters["wrong_format"] == 0:
            log.warning("%s; such images are dropped", why)
        self._counters["wrong_format"] += 1

    def _keep_up(self, now: _Open) -> None:
        """What is due beside the frames: the camera's clock, whether it still answers, how it fares, test triggers."""
        t_ns = time.monotonic_ns()
        trigger = self._options.trigger
        if trigger.source == "software" and t_ns >= self._fire_ns:
            with losses("triggering"):
                now.connection.camera.execute("TriggerSoftware")
            self._fire_ns = max(self._fire_ns + round(1e9 / trigger.rate_hz), t_ns)
        now.timing.follow(t_ns)
        if t_ns - self._heard_ns > self._options.read_timeout_s * 1e9:
            now.connection.probe()
            self._heard_ns = t_ns
        if t_ns >= self._look_ns:
            self._look(now)

    def _look(self, now: _Open) -> None:
        """How the camera fares, about once a second."""
        self._look_ns = time.monotonic_ns() + _LOOK_NS
        camera: Features = now.connection.camera
        with losses("reading its temperature"):
            temperature = camera.read("DeviceTemperature")
            missed = camera.read("TriggersMissed")
        self._temperature_c = None if temperature is None else float(temperature)
        if missed is not None:
            self._seen.setdefault("missed_trigger", int(missed))
            self._grow("missed_trigger", int(missed))
        self._count_losses(now)
        self._counters["without_stamp"] = now.timing.without_stamp
        self._counters["clock_resets"] = now.timing.clock.resets
        if now.timing.clock.ready:
            self._counters["clock_uncertainty_us"] = now.timing.clock.uncertainty_ns() // 1000


class _Asked:
    """Questions to a buffer; producers answer few of them, each in its own way of saying no."""

    def __init__(self, buffer: Any) -> None:
        self._buffer = buffer

    def number(self, name: str) -> int | None:
        try:
            return int(getattr(self._buffer, name))
        except (*GENICAM_ERRORS, AttributeError, TypeError):
            return None


def _exposure_us(camera: Features, asked: _Asked) -> float | None:
    """What the image itself says."""
    if not asked.number("num_chunks"):
        return None
    found = camera.read("ChunkExposureTime")
    return None if found is None else float(found)


def open_alone(side: Side, options: Mapping[str, Any], base_dir: Path) -> GenicamCamera:
    """The camera for a process that has nothing else to do: it may wait inside the producer."""
    checked = parse(side, options)
    return GenicamCamera(side, checked, producers(checked.producer, base_dir), wait_ms=_WAIT_ALONE_MS)


_WAIT_ALONE_MS = 5
