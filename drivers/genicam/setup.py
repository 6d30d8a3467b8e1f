"""Sets a camera up for hardware-triggered measuring, in the order in which features depend on each other.

What must be as asked (trigger, exposure, pixel format, region) or else the measurement would be wrong raises
SettingRefused; anything else that a camera lacks, refuses or rounds becomes a note.
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
    """What the camera took.

    Args:
        size: (width, height). exposure_us: 0 if unknown. notes: what is not as asked, in sentences.
    """

    pixels: PixelFormat
    size: tuple[int, int]
    exposure_us: float
    notes: tuple[str, ...]


class CameraSetup:
    """One go at setting up a stopped camera.

    Args:
        camera, stream: features of the camera and of its data stream.
    """

    def __init__(self, camera: Features, stream: Features, options: Options) -> None:
        self._camera, self._stream, self._options = camera, stream, options
        self._notes: list[str] = []

    def run(self) -> Setup:
        """Do it; SettingRefused names what stands in the way."""
        self._camera.execute("AcquisitionStop")
        self._try("TLParamsLocked", 0, note=False)
        self._must("AcquisitionMode", "Continuous")
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

    def _trigger(self, wanted: Trigger) -> None:
        camera = self._camera
        for selector in camera.choices("TriggerSelector"):
            camera.write("TriggerSelector", selector)
            self._try("TriggerMode", "Off", note=False)
        if wanted.source == "free_run":
            self._try("TriggerMode", "Off", note=False)
            return
        if camera.find("TriggerSelector") is not None:
            self._must("TriggerSelector", wanted.selector)
        elif wanted.selector != "FrameStart":
            raise SettingRefused(f"trigger.selector {wanted.selector}: this camera has one trigger only; leave it out")
        self._must("TriggerMode", "On")
        if wanted.source == "software":
            self._must("TriggerSource", "Software")
            return
        self._must("TriggerSource", wanted.line)
        self._edge(wanted)
        if wanted.delay_us or camera.writable("TriggerDelay"):
            self._number("TriggerDelay", wanted.delay_us)
        self._line(wanted)

    def _edge(self, wanted: Trigger) -> None:
        if self._camera.find("TriggerActivation") is not None:
            self._must("TriggerActivation", _EDGES[wanted.edge])
        elif wanted.edge != "rising":
            raise SettingRefused("trigger.edge falling: this camera has no TriggerActivation; leave it out")

    def _line(self, wanted: Trigger) -> None:
        if wanted.line in self._camera.choices("LineSelector"):
            self._camera.write("LineSelector", wanted.line)
            self._try("LineMode", "Input")
            if wanted.inverted or self._camera.writable("LineInverter"):
                self._must("LineInverter", wanted.inverted)
        elif wanted.inverted:
            raise SettingRefused(f"trigger.inverted: this camera has no LineInverter for {wanted.line}; leave it out")

    def _exposure(self) -> None:
        self._try("ExposureMode", "Timed")
        if self._options.exposure_us is not None:
            self._camera.write("ExposureTime", self._options.exposure_us)

    def _exposure_taken(self) -> float:
        """What the exposure is in the end; formats and regions may have moved its limits."""
        wanted, took = self._options.exposure_us, float(self._camera.read("ExposureTime") or 0.0)
        if wanted is None or took == wanted:
            return took
        if abs(took - wanted) > _EXPOSURE_TOLERANCE * wanted:
            limits = self._camera.limits("ExposureTime")
            allowed = f"; {limits[0]:g} to {limits[1]:g} us are possible" if limits else ""
            raise SettingRefused(f"exposure_us {wanted:g} became {took:g}{allowed}")
        self._note(f"exposure_us {wanted:g} became {took:g}")
        return took

    def _format(self) -> PixelFormat:
        wanted = self._options.pixel_format
        if wanted is not None and self._camera.read("PixelFormat") != wanted:
            self._must("PixelFormat", wanted)
        name = str(self._camera.read("PixelFormat"))
        pixels = BY_NAME.get(name)
        if pixels is None:
            usable = [choice for choice in self._camera.choices("PixelFormat") if choice in BY_NAME]
            raise SettingRefused(
                f"pixel_format {name} cannot be read; of this camera's formats these can: {', '.join(usable) or 'none'}"
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
            self._place(roi, pixels)
        return int(self._camera.read("Width")), int(self._camera.read("Height"))

    def _place(self, roi: Roi, pixels: PixelFormat) -> None:
        """Size and place, both as asked or as near as the camera's steps allow."""
        for name, key, wanted in (("Width", "width", roi.width), ("Height", "height", roi.height)):
            took = wanted if self._camera.read(name) == wanted else self._camera.write(name, wanted)
            if took != wanted:
                self._note(f"roi.{key} {wanted} became {took}")
        for name, key, wanted in (("OffsetX", "x", roi.x), ("OffsetY", "y", roi.y)):
            # An odd offset turns a Bayer pattern into another one, and cameras disagree whether they then rename it.
            asked = wanted - wanted % 2 if pixels.encoding.startswith("bayer") else wanted
            took = self._camera.read(name) or 0
            if took != asked:
                took = self._camera.write(name, asked)
            if took != wanted:
                self._note(f"roi.{key} {wanted} became {took}")
            if took % 2 and pixels.encoding.startswith("bayer"):
                raise SettingRefused(f"roi.{key} {wanted} became {took}: a Bayer pattern needs an even one")

    def _chunks(self) -> None:
        if not self._try("ChunkModeActive", True, note=False):
            return
        there = self._camera.choices("ChunkSelector")
        for chunk in _CHUNKS:
            if chunk in there:
                self._camera.write("ChunkSelector", chunk)
                self._try("ChunkEnable", True, note=False)

    def _feature(self, name: str, value: Any) -> None:
        took = self._camera.write(name, value)
        if took != value:
            self._note(f"features.{name} {value} became {took}")

    def _must(self, name: str, value: Any) -> None:
        """Set what the measurement depends on."""
        if self._camera.read(name) == value:
            return
        took = self._camera.write(name, value)
        if took != value:
            raise SettingRefused(f"{name} became {took} instead of {value}")

    def _number(self, name: str, value: float) -> None:
        took = self._camera.write(name, value)
        if abs(float(took) - value) > 1e-9 * max(abs(value), 1.0):
            self._note(f"{self._camera.name(name)} {value:g} became {float(took):g}")

    def _try(self, name: str, value: Any, *, note: bool = True) -> bool:
        return self._attempt(self._camera, name, value, note=note)

    def _try_stream(self, name: str, value: Any) -> bool:
        return self._attempt(self._stream, name, value, note=True)

    def _attempt(self, features: Features, name: str, value: Any, *, note: bool) -> bool:
        """Set what is good to have; a camera without it does what we want anyway."""
        if features.find(name) is None:
            return False
        if features.read(name) == value:
            return True
        try:
            took = features.write(name, value)
        except SettingRefused as error:
            if note:
                self._note(str(error))
            return False
        if note and took != value:
            self._note(f"{name} {value} became {took}")
        return bool(took == value)

    def _note(self, text: str) -> None:
        self._notes.append(text)
