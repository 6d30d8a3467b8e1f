"""Set-up of a camera for hardware-triggered measuring, in the order in which features depend on each other.

A setting without which the measurement would be wrong (trigger, exposure, pixel format, region) raises SettingRefused;
any other that a camera lacks, refuses or rounds becomes a note.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivers.errors import SettingRefused
from drivers.genicam.features import Features
from drivers.genicam.formats import BY_NAME, PixelFormat
from drivers.genicam.options import Options, Roi, Trigger

_EXPOSURE_TOLERANCE = 0.01
_AUTOS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto", "GammaAuto")
_CHUNKS = ("Timestamp", "FrameID", "ExposureTime")
_EDGES = {"rising": "RisingEdge", "falling": "FallingEdge"}


@dataclass(frozen=True, slots=True)
class Setup:
    """Settings of the camera after the set-up.

    Args:
        size: (width, height). exposure_us: 0 if unknown. notes: deviations from the options, in sentences.
    """

    pixels: PixelFormat
    size: tuple[int, int]
    exposure_us: float
    notes: tuple[str, ...]


class CameraSetup:
    """The set-up of a stopped camera.

    Args:
        camera, stream: features of the camera and of its data stream.
    """

    def __init__(self, camera: Features, stream: Features, options: Options) -> None:
        self._camera, self._stream, self._options = camera, stream, options
        self._notes: list[str] = []

    def run(self) -> Setup:
        """Set the camera up; SettingRefused names the setting that failed."""
        self._camera.execute("AcquisitionStop")
        self._try("TLParamsLocked", 0, note=False)
        self._require("AcquisitionMode", "Continuous")
        self._trigger(self._options.trigger)
        for name in _AUTOS:
            self._try(name, "Off")
        self._try("GammaEnable", False)
        self._exposure()
        if self._options.gain is not None:
            self._number("Gain", self._options.gain)
        pixels = self._format()
        size = self._region(pixels)
        self._try("AcquisitionFrameRateEnable", False)
        self._chunks()
        self._try_stream("StreamBufferHandlingMode", "OldestFirst")
        for name, value in self._options.features.items():
            self._feature(name, value)
        return Setup(pixels, size, self._exposure_taken(), tuple(self._notes))

    def _trigger(self, trigger: Trigger) -> None:
        camera = self._camera
        for selector in camera.choices("TriggerSelector"):
            camera.write("TriggerSelector", selector)
            self._try("TriggerMode", "Off", note=False)
        if trigger.source == "free_run":
            self._try("TriggerMode", "Off", note=False)
            return
        if camera.find("TriggerSelector") is not None:
            self._require("TriggerSelector", trigger.selector)
        elif trigger.selector != "FrameStart":
            raise SettingRefused(f"trigger.selector {trigger.selector}: this camera has one trigger only; leave it out")
        self._require("TriggerMode", "On")
        if trigger.source == "software":
            self._require("TriggerSource", "Software")
            return
        self._require("TriggerSource", trigger.line)
        self._edge(trigger)
        if trigger.delay_us or camera.writable("TriggerDelay"):
            self._number("TriggerDelay", trigger.delay_us)
        self._line(trigger)

    def _edge(self, trigger: Trigger) -> None:
        if self._camera.find("TriggerActivation") is not None:
            self._require("TriggerActivation", _EDGES[trigger.edge])
        elif trigger.edge != "rising":
            raise SettingRefused("trigger.edge falling: this camera has no TriggerActivation; leave it out")

    def _line(self, trigger: Trigger) -> None:
        if trigger.line in self._camera.choices("LineSelector"):
            self._camera.write("LineSelector", trigger.line)
            self._try("LineMode", "Input")
            if trigger.inverted or self._camera.writable("LineInverter"):
                self._require("LineInverter", trigger.inverted)
        elif trigger.inverted:
            raise SettingRefused(f"trigger.inverted: this camera has no LineInverter for {trigger.line}; leave it out")

    def _exposure(self) -> None:
        self._try("ExposureMode", "Timed")
        if self._options.exposure_us is not None:
            self._camera.write("ExposureTime", self._options.exposure_us)

    def _exposure_taken(self) -> float:
        """Return the exposure after the set-up; formats and regions may have changed its limits."""
        requested, actual = self._options.exposure_us, float(self._camera.read("ExposureTime") or 0.0)
        if requested is None or actual == requested:
            return actual
        if abs(actual - requested) > _EXPOSURE_TOLERANCE * requested:
            limits = self._camera.limits("ExposureTime")
            allowed = f"; {limits[0]:g} to {limits[1]:g} us are possible" if limits else ""
            raise SettingRefused(f"exposure_us {requested:g} became {actual:g}{allowed}")
        self._note(f"exposure_us {requested:g} became {actual:g}")
        return actual

    def _format(self) -> PixelFormat:
        requested = self._options.pixel_format
        if requested is not None and self._camera.read("PixelFormat") != requested:
            self._require("PixelFormat", requested)
        name = str(self._camera.read("PixelFormat"))
        pixels = BY_NAME.get(name)
        if pixels is None:
            usable = [choice for choice in self._camera.choices("PixelFormat") if choice in BY_NAME]
            raise SettingRefused(
                f"pixel_format {name} is not supported; supported ones of this camera: {', '.join(usable) or 'none'}"
            )
        if pixels.reduced:
            self._note(f"pixel_format {name}: its {pixels.depth} bits are reduced to 8")
        return pixels

    def _region(self, pixels: PixelFormat) -> tuple[int, int]:
        roi = self._options.roi
        for name in ("OffsetX", "OffsetY"):
            self._try(name, 0, note=False)
        if roi is None:
            for name, limit in (("Width", "WidthMax"), ("Height", "HeightMax")):
                if (largest := self._camera.read(limit)) is not None:
                    self._try(name, largest, note=False)
        else:
            self._set_roi(roi, pixels)
        return int(self._camera.read("Width")), int(self._camera.read("Height"))

    def _set_roi(self, roi: Roi, pixels: PixelFormat) -> None:
        """Set size and offset, as near to the options as the camera's steps allow."""
        for name, key, requested in (("Width", "width", roi.width), ("Height", "height", roi.height)):
            actual = requested if self._camera.read(name) == requested else self._camera.write(name, requested)
            if actual != requested:
                self._note(f"roi.{key} {requested} became {actual}")
        for name, key, requested in (("OffsetX", "x", roi.x), ("OffsetY", "y", roi.y)):
            # An odd offset changes the Bayer pattern, and cameras differ in whether they then rename it.
            even = requested - requested % 2 if pixels.encoding.startswith("bayer") else requested
            actual = self._camera.read(name) or 0
            if actual != even:
                actual = self._camera.write(name, even)
            if actual != requested:
                self._note(f"roi.{key} {requested} became {actual}")
            if actual % 2 and pixels.encoding.startswith("bayer"):
                raise SettingRefused(f"roi.{key} {requested} became {actual}: a Bayer pattern needs an even one")

    def _chunks(self) -> None:
        if not self._try("ChunkModeActive", True, note=False):
            return
        available = self._camera.choices("ChunkSelector")
        for chunk in _CHUNKS:
            if chunk in available:
                self._camera.write("ChunkSelector", chunk)
                self._try("ChunkEnable", True, note=False)

    def _feature(self, name: str, value: Any) -> None:
        actual = self._camera.write(name, value)
        if actual != value:
            self._note(f"features.{name} {value} became {actual}")

    def _require(self, name: str, value: Any) -> None:
        """Set a feature that the measurement depends on."""
        if self._camera.read(name) == value:
            return
        actual = self._camera.write(name, value)
        if actual != value:
            raise SettingRefused(f"{name} became {actual} instead of {value}")

    def _number(self, name: str, value: float) -> None:
        actual = self._camera.write(name, value)
        if abs(float(actual) - value) > 1e-9 * max(abs(value), 1.0):
            self._note(f"{self._camera.name(name)} {value:g} became {float(actual):g}")

    def _try(self, name: str, value: Any, *, note: bool = True) -> bool:
        return self._attempt(self._camera, name, value, note=note)

    def _try_stream(self, name: str, value: Any) -> bool:
        return self._attempt(self._stream, name, value, note=True)

    def _attempt(self, features: Features, name: str, value: Any, *, note: bool) -> bool:
        """Set a feature if possible; a camera without it needs no such setting."""
        if features.find(name) is None:
            return False
        if features.read(name) == value:
            return True
        try:
            actual = features.write(name, value)
        except SettingRefused as error:
            if note:
                self._note(str(error))
            return False
        if note and actual != value:
            self._note(f"{name} {value} became {actual}")
        return bool(actual == value)

    def _note(self, text: str) -> None:
        self._notes.append(text)
