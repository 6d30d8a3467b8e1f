"""A GenICam camera in this process; :func:`drivers.genicam.open_camera` runs it in a process of its own."""

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
from drivers.genicam.features import GENICAM_ERRORS, Features, device_lost_errors
from drivers.genicam.numbering import TriggerNumbers
from drivers.genicam.options import Options, parse, producers
from drivers.genicam.setup import CameraSetup, Setup
from drivers.genicam.timing import Timing
from drivers.host_clocks import Clocks
from drivers.protocols import CameraHealth, CameraInfo, Frame, Side

log = logging.getLogger(__name__)

_POLL_S = 0.0005
_STATUS_NS = 1_000_000_000


@dataclass(slots=True, eq=False)
class _Open:
    """State of an open camera."""

    connection: Connection
    setup: Setup
    timing: Timing
    numbers: TriggerNumbers


class GenicamCamera:
    """Implements :class:`drivers.protocols.Camera` through harvesters.

    Args:
        producer_paths: .cti files. wait_ms: how long to wait inside the producer, where Python's lock is held; 0 polls
            twice a millisecond instead, for processes with other tasks.

    Attributes:
        allocate: returns the memory of an image; a process that shares its images replaces it.
    """

    def __init__(self, side: Side, options: Options, producer_paths: list[Path], *, wait_ms: int = 0) -> None:
        self.side = side
        self.allocate: Callable[..., Any] = np.empty
        self._options, self._producers, self._wait_ms = options, producer_paths, wait_ms
        self._open: _Open | None = None
        self._acquiring = False
        self._counters = {"incomplete": 0, "no_buffer": 0, "missed_trigger": 0, "lost": 0, "wrong_format": 0}
        self._readings: dict[str, int] = {}
        self._temperature_c: float | None = None
        self._received_ns = self._status_ns = self._fire_ns = 0
        self._unexplained_before = self._lost_in_run = 0

    def open(self) -> CameraInfo:
        """Connect and set up.

        Raises:
            DeviceLost: no such camera, or it is in use. SettingRefused: it cannot measure as configured.
        """
        self.close()
        connection = Connection(self._producers, self._options, wait_ms=self._wait_ms)
        try:
            with device_lost_errors("setting it up"):
                setup = CameraSetup(connection.camera, connection.stream, self._options).run()
                timing = Timing(connection.camera, offset_us=self._options.timestamp_offset_us)
        except GENICAM_ERRORS as error:
            connection.close()
            raise DriverError(f"{connection.device.model} cannot be set up: {error}") from error
        except BaseException:
            connection.close()
            raise
        numbers = TriggerNumbers(1 if connection.device.transport == "GEV" else 0)
        self._open = _Open(connection, setup, timing, numbers)
        self._readings = {}
        self._read_status(self._open)
        notes = list(setup.notes)
        if not timing.latches:
            notes.append("this camera's clock cannot be read; exposure times follow the earliest arrivals")
        return CameraInfo(
            connection.device.model,
            connection.device.serial,
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
        self._unexplained_before, self._lost_in_run = self._unexplained(now), 0
        self._acquiring = True
        self._received_ns = time.monotonic_ns()

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next frame, None when none came in time; DeviceLost when the camera no longer answers."""
        now = self._now()
        end = time.monotonic() + timeout_s
        while True:
            self._poll(now)
            buffer = now.connection.fetch()
            if buffer is not None:
                try:
                    frame = self._frame(now, buffer, Clocks.now())
                finally:
                    now.connection.requeue(buffer)
                self._received_ns = time.monotonic_ns()
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
        """Release the camera; never raises."""
        if self._open is not None:
            self._open.connection.close()
            self._open = None
        self._acquiring = False

    def health(self) -> CameraHealth:
        """Return the health as of about a second ago."""
        return CameraHealth(self._temperature_c, dict(self._counters))

    def _now(self) -> _Open:
        if self._open is None:
            raise DeviceLost(f"the {self.side} camera is not open")
        return self._open

    def _frame(self, now: _Open, buffer: Any, clocks: Clocks) -> Frame | None:
        """Return the frame in a buffer, copied out of it; None for an image of another size or format."""
        setup, camera = now.setup, now.connection.camera
        width, height = setup.size
        info = _BufferInfo(buffer)
        code, size = info.number("pixel_format"), (info.number("width"), info.number("height"))
        pixels = formats.BY_CODE.get(code, setup.pixels) if code is not None else setup.pixels
        if pixels.encoding != setup.pixels.encoding or size not in (setup.size, (None, None)):
            self._drop(f"an image of {size} {pixels.name} came instead of {setup.size} {setup.pixels.name}")
            return None
        start = info.number("image_offset") or 0
        filled = info.number("size_filled")
        raw = np.frombuffer(buffer.raw_buffer, np.uint8)
        image = self.allocate(pixels.frame_shape(width, height), pixels.dtype)
        try:
            formats.convert(
                raw[start : filled or raw.size], pixels, width, height, image, padding=info.number("padding_x") or 0
            )
        except ValueError as error:
            self._drop(str(error))
            return None
        image.flags.writeable = False
        exposure_us = _exposure_us(camera, info) or setup.exposure_us
        when = now.timing.exposure(buffer, clocks.monotonic_ns, exposure_us)
        frame_id = info.number("frame_id")
        if frame_id is None:
            chunk = camera.read("ChunkFrameID")
            frame_id = None if chunk is None else int(chunk)
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
        """Return the trigger number; gaps that no other counter explains are counted as lost."""
        numbers = now.numbers
        before, by_time = numbers.gaps, numbers.by_time
        trigger = numbers.number(frame_id, stamp_ns)
        if numbers.by_time and not by_time:
            log.warning("the camera's frame numbers do not increase (%s); frames are numbered by time", frame_id)
        self._counters["numbered_by_time"] = self._counters.get("numbered_by_time", 0) + numbers.by_time
        if numbers.gaps > before:
            self._count_device_lost_errors(now)
            unexplained = self._unexplained(now) - self._unexplained_before
            self._counters["lost"] += max(unexplained - self._lost_in_run, 0)
            self._lost_in_run = max(unexplained, self._lost_in_run)
        return trigger

    def _unexplained(self, now: _Open) -> int:
        """Return the missing frames that no other counter explains."""
        return now.numbers.gaps - self._counters["incomplete"] - self._counters["no_buffer"]

    def _count_device_lost_errors(self, now: _Open) -> None:
        """Update the counters of frames that were lost in transit."""
        self._count_growth("incomplete", now.connection.incomplete)
        self._count_growth("no_buffer", now.connection.underruns())

    def _count_growth(self, name: str, reading: int) -> None:
        """Add the growth of a camera's counter; one that decreased was restarted."""
        before = self._readings.get(name, 0)
        self._counters[name] += reading - before if reading >= before else reading
        self._readings[name] = reading

    def _drop(self, reason: str) -> None:
        if self._counters["wrong_format"] == 0:
            log.warning("%s; such images are dropped", reason)
        self._counters["wrong_format"] += 1

    def _poll(self, now: _Open) -> None:
        """Execute what is due beside the frames: test triggers, clock, connection check, status."""
        t_ns = time.monotonic_ns()
        trigger = self._options.trigger
        if trigger.source == "software" and t_ns >= self._fire_ns:
            with device_lost_errors("triggering"):
                now.connection.camera.execute("TriggerSoftware")
            self._fire_ns = max(self._fire_ns + round(1e9 / trigger.rate_hz), t_ns)
        now.timing.follow(t_ns)
        if t_ns - self._received_ns > self._options.read_timeout_s * 1e9:
            now.connection.probe()
            self._received_ns = t_ns
        if t_ns >= self._status_ns:
            self._read_status(now)

    def _read_status(self, now: _Open) -> None:
        """Read the camera's status, about once a second."""
        self._status_ns = time.monotonic_ns() + _STATUS_NS
        camera: Features = now.connection.camera
        with device_lost_errors("reading its temperature"):
            temperature = camera.read("DeviceTemperature")
            missed = camera.read("TriggersMissed")
        self._temperature_c = None if temperature is None else float(temperature)
        if missed is not None:
            self._readings.setdefault("missed_trigger", int(missed))
            self._count_growth("missed_trigger", int(missed))
        self._count_device_lost_errors(now)
        self._counters["without_stamp"] = now.timing.without_stamp
        self._counters["clock_resets"] = now.timing.clock.resets
        if now.timing.clock.ready:
            self._counters["clock_uncertainty_us"] = now.timing.clock.uncertainty_ns() // 1000


class _BufferInfo:
    """Properties of a buffer; producers provide few of them and signal the others' absence in different ways."""

    def __init__(self, buffer: Any) -> None:
        self._buffer = buffer

    def number(self, name: str) -> int | None:
        try:
            return int(getattr(self._buffer, name))  # a GenTL buffer: its properties vary with the producer
        except (*GENICAM_ERRORS, AttributeError, TypeError):
            return None


def _exposure_us(camera: Features, info: _BufferInfo) -> float | None:
    """Return the exposure time from the image's chunk data."""
    if not info.number("num_chunks"):
        return None
    chunk = camera.read("ChunkExposureTime")
    return None if chunk is None else float(chunk)


def open_alone(side: Side, options: Mapping[str, Any], base_dir: Path) -> GenicamCamera:
    """Create the camera for a process without other tasks: it may wait inside the producer."""
    checked = parse(side, options)
    return GenicamCamera(side, checked, producers(checked.producer, base_dir), wait_ms=_WAIT_ALONE_MS)


_WAIT_ALONE_MS = 5
