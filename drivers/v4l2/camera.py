"""A V4L2 camera behind the drivers' protocol."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.host_clocks import Clocks
from drivers.protocols import CameraHealth, CameraInfo, Frame, Side
from drivers.v4l2 import discovery, formats
from drivers.v4l2 import structs as v
from drivers.v4l2.controls import Controls
from drivers.v4l2.device import Device
from drivers.v4l2.kernel import Kernel, LinuxKernel
from drivers.v4l2.options import Options, from_mapping
from drivers.v4l2.stream import Stream, Taken
from drivers.v4l2.timing import Sequence, realtime_of

COUNTERS = (
    "received", "error_frames", "kernel_dropped", "short_frames", "corrupt_jpeg", "sequence_restarts",
    "without_timestamp", "lost_device",
)  # fmt: skip
_EXPOSURE_UNIT_US = 100.0
"""Of the control exposure_time_absolute."""


def open_camera(side: Side, options: Mapping[str, Any], base_dir: Path) -> V4l2Camera:  # noqa: ARG001  # the table's
    """Create a closed camera; ValueError names the invalid option ``cameras.<side>.<key>``."""
    return V4l2Camera(side, from_mapping(side, options))


@dataclass(slots=True, eq=False)
class _Opened:
    """State of an open camera; ``stream`` while it acquires."""

    device: Device
    format: formats.PixelFormat
    layout: formats.Layout
    exposure_us: float
    stream: Stream | None = None


class V4l2Camera:
    """One camera of the rig.

    A lost device is closed at once; ``open`` finds it again when it is back.

    Args:
        side: which camera; options: checked; kernel: the system's if None.
    """

    def __init__(self, side: Side, options: Options, *, kernel: Kernel | None = None) -> None:
        self.side, self.options = side, options
        self._kernel = kernel or LinuxKernel()
        self._name = f"camera {side}"
        self._opened: _Opened | None = None
        self._sequence = Sequence()
        self._counters: Counter[str] = Counter(dict.fromkeys(COUNTERS, 0))

    def health(self) -> CameraHealth:
        """Return received frames, and lost ones by reason; V4L2 has no temperature."""
        return CameraHealth(counters=dict(self._counters))

    def open(self) -> CameraInfo:
        """Connect and set up; CameraInfo.notes lists each setting that was refused or rounded."""
        if self._opened is not None:
            raise DriverError(f"{self._name}: open() while it is open; close() it first")
        path = discovery.resolve(self.options.device, self._name, kernel=self._kernel)
        device = Device(self._kernel, path, self._name)
        try:
            device.check_capture()
            return self._set_up(device, path)
        except DriverError:
            device.close()
            raise

    def start(self) -> None:
        """Map the buffers and start; frame numbers count from 0."""
        opened = self._is_open("start")
        if opened.stream is not None:
            raise DriverError(f"{self._name}: start() while it is acquiring; stop() it first")
        try:
            stream = Stream(opened.device, self.options.buffers)
            try:
                stream.start()
            except DriverError:
                stream.close()
                raise
        except DeviceLost:
            self._lost()
            raise
        self._sequence = Sequence()
        opened.stream = stream

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next valid frame, or None when none came in time; invalid ones are counted and skipped."""
        opened = self._is_open("read")
        if opened.stream is None:
            raise DriverError(f"{self._name}: read() before start()")
        end_s = time.monotonic() + timeout_s
        while True:
            try:
                with opened.stream.take(end_s - time.monotonic()) as taken:
                    frame = None if taken is None else self._frame(opened, taken)
            except DeviceLost:
                self._lost()
                raise
            if frame is not None or taken is None:
                return frame

    def stop(self) -> None:
        """Stop; frames not yet read are dropped, and the buffers are released."""
        opened = self._opened
        if opened is None or opened.stream is None:
            return
        stream, opened.stream = opened.stream, None
        try:
            stream.stop()
        except DeviceLost:
            self._lost()
            raise
        finally:
            stream.close()

    def close(self) -> None:
        """Release the device."""
        opened, self._opened = self._opened, None
        if opened is not None:
            if opened.stream is not None:
                opened.stream.close()
            opened.device.close()

    def _set_up(self, device: Device, path: str) -> CameraInfo:
        current = device.current_format()
        form = self._choose_format(device, v.fourcc_name(current.pixelformat))
        size = self.options.size or (current.width, current.height)
        pix = device.set_format(form.fourcc, size)
        notes = [f"{form.fourcc}: {form.note}"] if form.note else []
        if form.fourcc in ("YUYV", "UYVY") and (note := formats.colour_note(pix)):
            notes.append(note)
        notes += self._set_frame_rate(device)
        controls = Controls(device)
        notes += controls.set_all(self.options.controls)
        notes += self._trigger_notes(controls)
        exposure_us, note = _exposure_us(controls)
        notes += [note] if note else []
        self._opened = _Opened(device, form, formats.Layout((pix.width, pix.height), pix.bytesperline), exposure_us)
        serial = discovery.serial_of(path) or device.bus
        return CameraInfo(device.card, serial, (pix.width, pix.height), form.encoding, exposure_us, tuple(notes))

    def _choose_format(self, device: Device, current: str) -> formats.PixelFormat:
        offered = {form.fourcc: form for form in device.formats()}
        if self.options.format is not None:
            form = formats.named(self.options.format)
            if form is None or (offered and form.fourcc not in offered):
                listed = "; ".join(map(str, offered.values()))
                raise SettingRefused(
                    f"{self._name}: {device.card} does not offer the format {self.options.format}; there are: {listed}"
                )
            return form
        for code, form in formats.FORMATS.items():
            if code in offered or (not offered and code == current):
                return form
        listed = ", ".join(offered) or current
        raise SettingRefused(f"{self._name}: none of the formats of {device.card} is supported: {listed}")

    def _set_frame_rate(self, device: Device) -> list[str]:
        requested = self.options.frame_rate_hz
        if requested is None:
            return []
        actual = device.set_frame_rate(requested)
        if actual is None:
            return [f"frame_rate_hz: {requested:g} was refused, the camera has no frame rate setting"]
        exact = abs(actual / requested - 1) < 1e-3
        return [] if exact else [f"frame_rate_hz: {requested:g} was requested, the camera uses {actual:g}"]

    def _trigger_notes(self, controls: Controls) -> list[str]:
        if self.options.trigger == "software":
            return ["trigger: software: pairs are simultaneous by chance only; moving objects are measured wrongly"]
        if any("trigger" in name for name in self.options.controls):
            return []
        offered = [name for name in controls.supported if "trigger" in name]
        hint = f"set {' or '.join(offered)} in controls" if offered else "none of its controls names a trigger"
        return [f"trigger: hardware cannot be verified: make sure that the trigger line starts the exposures ({hint})"]

    def _frame(self, opened: _Opened, taken: Taken) -> Frame | None:
        """Return the frame, copied out of the buffer; None for an invalid one."""
        clocks = Clocks.now()
        trigger, missing = self._sequence.feed(taken.sequence)
        if missing < 0:
            self._counters["sequence_restarts"] += 1
        self._counters["kernel_dropped"] += max(0, missing)
        if taken.error:
            self._counters["error_frames"] += 1
            return None
        try:
            image = opened.format.convert(taken.data, opened.layout)
        except formats.CorruptFrame as error:
            self._counters[error.reason] += 1
            return None
        image.flags.writeable = False
        host_ns = clocks.to_realtime_ns(taken.done_ns)
        stamped_ns = realtime_of(taken.timestamp_ns, clocks)
        if stamped_ns is None:
            self._counters["without_timestamp"] += 1
        before_us = 0.0 if taken.at_start_of_exposure and stamped_ns is not None else self._before_stamp_us(opened)
        self._counters["received"] += 1
        return Frame(
            self.side,
            trigger,
            (host_ns if stamped_ns is None else stamped_ns) - round(before_us * 1000),
            host_ns,
            opened.format.encoding,
            image,
            opened.exposure_us,
            frame_id=taken.sequence,
        )

    def _before_stamp_us(self, opened: _Opened) -> float:
        """Return the time from the start of exposure to a stamp at the end of the frame."""
        return opened.exposure_us + self.options.end_of_frame_delay_us

    def _is_open(self, method: str) -> _Opened:
        if self._opened is None:
            raise DriverError(f"{self._name}: {method}() while it is closed; open() comes first")
        return self._opened

    def _lost(self) -> None:
        self._counters["lost_device"] += 1
        self.close()


def _exposure_us(controls: Controls) -> tuple[float, str]:
    """Return the exposure time, 0 if unknown, and a note where it is."""
    mode, time = controls.by_id(v.CID_EXPOSURE_AUTO), controls.by_id(v.CID_EXPOSURE_ABSOLUTE)
    if time is None:
        return 0.0, ""
    manual = (v.EXPOSURE_AUTO_MANUAL, v.EXPOSURE_AUTO_SHUTTER_PRIORITY)
    if mode is not None and controls.get(mode) not in manual:
        return 0.0, f"the exposure time is automatic and therefore unknown; set {mode.name}: manual, {time.name}: ..."
    return (controls.get(time) or 0) * _EXPOSURE_UNIT_US, ""
