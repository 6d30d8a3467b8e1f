"""RandR: outputs, modes, gamma tables, by ctypes on libXrandr."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_int, c_long, c_ubyte, c_ulong, c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError
from drivers.projector.x11.detected_output import DetectedOutput
from drivers.projector.x11.edid import monitor_name
from drivers.projector.x11.randr_structures import IDENTITY, ModeInfo, OutputInfo, TransformAttributes, xrandr
from drivers.projector.x11.xlib import XID, Connection

CONNECTED = 0
INTERLACE, DOUBLE_SCAN = 1 << 4, 1 << 5
ROTATIONS = {1: "normal", 2: "left", 4: "inverted", 8: "right"}
REFLECT = 16 | 32
CHANGES = 1 << 0 | 1 << 1 | 1 << 2  # screen, CRTC and output
GAMMA_TOLERANCE = 257
"""One step of 8 bits: servers round their linear table in different ways."""
EDID_LIMIT_LONGS = 8192
FULL_RANGE = {"Broadcast RGB": ("Full",), "underscan": ("off",), "scaling mode": ("None", "Full", "Center")}
"""Properties of outputs that change pixels or their values, and their accepted values."""


class Randr:
    """RandR of one connection.

    Args:
        connection: to the server.

    Raises:
        DriverError: the server has no RandR 1.3.
    """

    def __init__(self, connection: Connection) -> None:
        self._x, self._lib = connection, xrandr()
        base, error, major, minor = c_int(), c_int(), c_int(), c_int()
        if not self._lib.XRRQueryExtension(connection.handle, byref(base), byref(error)):
            raise DriverError(f"X display {connection.name} has no RandR extension, so outputs cannot be distinguished")
        self._lib.XRRQueryVersion(connection.handle, byref(major), byref(minor))
        if (major.value, minor.value) < (1, 3):
            raise DriverError(f"X display {connection.name} has RandR {major.value}.{minor.value}, 1.3 is needed")
        self.event_base = base.value

    def watch(self) -> None:
        """Request events, numbered from ``event_base``, when outputs or modes change."""
        self._lib.XRRSelectInput(self._x.handle, self._x.root, CHANGES)

    def outputs(self, *, probe: bool = False) -> list[DetectedOutput]:
        """List every output; ``probe`` queries the hardware, which can take half a second and make screens flicker."""
        return self._outputs(probe, None)

    def output(self, name: str) -> DetectedOutput | None:
        """Return the present state of one output from the server."""
        return next(iter(self._outputs(False, name)), None)

    def _outputs(self, probe: bool, only: str | None) -> list[DetectedOutput]:
        with self._resources(probe) as resources:
            modes = {m.id: m for m in resources.contents.modes[: resources.contents.nmode]}
            primary = self._lib.XRRGetOutputPrimary(self._x.handle, self._x.root)
            detected = []
            for output in resources.contents.outputs[: resources.contents.noutput]:
                described = self._output(resources, modes, output, primary, only)
                if described is not None:
                    detected.append(described)
        self._x.sync()
        return detected

    def crtc_of(self, name: str) -> int:
        """Return the CRTC that drives an output, 0 if none does."""
        with self._resources(False) as resources:
            for output in resources.contents.outputs[: resources.contents.noutput]:
                info = self._lib.XRRGetOutputInfo(self._x.handle, resources, output)
                if info:
                    crtc, text = int(info.contents.crtc), _name(info.contents)
                    self._lib.XRRFreeOutputInfo(info)
                    if text == name:
                        return crtc
        return 0

    def gamma(self, crtc: int) -> NDArray[np.uint16] | None:
        """Return the gamma table, (3, N) uint16; None if the CRTC has none."""
        if self._lib.XRRGetCrtcGammaSize(self._x.handle, crtc) < 2:
            return None
        table = self._lib.XRRGetCrtcGamma(self._x.handle, crtc)
        if not table:
            return None
        size = table.contents.size
        channels = [getattr(table.contents, name)[:size] for name in ("red", "green", "blue")]
        self._lib.XRRFreeGamma(table)
        return np.array(channels, np.uint16)

    def set_gamma(self, crtc: int, gamma: NDArray[np.uint16]) -> None:
        """Load a gamma table of the size from :meth:`gamma`."""
        table = self._lib.XRRAllocGamma(gamma.shape[1])
        for name, values in zip(("red", "green", "blue"), gamma, strict=True):
            ctypes.memmove(getattr(table.contents, name), np.ascontiguousarray(values).ctypes.data, values.nbytes)
        self._lib.XRRSetCrtcGamma(self._x.handle, crtc, table)
        self._lib.XRRFreeGamma(table)
        self._x.sync()

    @contextmanager
    def _resources(self, probe: bool) -> Iterator[Any]:
        get = self._lib.XRRGetScreenResources if probe else self._lib.XRRGetScreenResourcesCurrent
        resources = get(self._x.handle, self._x.root)
        if not resources:
            raise DriverError(f"X display {self._x.name} reports no RandR outputs")
        try:
            yield resources
        finally:
            self._lib.XRRFreeScreenResources(resources)

    def _output(
        self, resources: Any, modes: dict[int, ModeInfo], output: int, primary: int, only: str | None
    ) -> DetectedOutput | None:
        pointer = self._lib.XRRGetOutputInfo(self._x.handle, resources, output)
        if not pointer:
            return None
        info = pointer.contents
        name, connected, crtc = _name(info), info.connection == CONNECTED, int(info.crtc)
        first = modes.get(info.modes[0]) if info.npreferred and info.nmode else None
        self._lib.XRRFreeOutputInfo(pointer)
        if only is not None and name != only:
            return None
        driven = self._crtc(resources, modes, crtc) if crtc else {}
        return DetectedOutput(
            name=name,
            connected=connected,
            primary=output == primary,
            preferred_size=(first.width, first.height) if first else None,
            edid_name=monitor_name(self._property(output, "EDID")) if connected else "",
            notes=self._settings(output) if connected else (),
            **driven,
        )

    def _crtc(self, resources: Any, modes: dict[int, ModeInfo], crtc: int) -> dict[str, Any]:
        pointer = self._lib.XRRGetCrtcInfo(self._x.handle, resources, crtc)
        if not pointer:
            return {}
        info, mode = pointer.contents, modes.get(pointer.contents.mode)
        size, rotation = (info.width, info.height), info.rotation
        position = info.x, info.y
        self._lib.XRRFreeCrtcInfo(pointer)
        if mode is None:
            return {}
        mode_size = mode.width, mode.height
        upright = mode_size if rotation & (1 | 4) else mode_size[::-1]
        gamma = self.gamma(crtc)
        if gamma is not None and not gamma.any() and not mode.dot_clock:
            gamma = None  # a server without hardware that never loaded a table
        return {
            "size": size,
            "position": position,
            "refresh_hz": refresh_hz(mode),
            "mode": (mode.name or b"").decode(errors="replace"),
            "mode_size": mode_size,
            "gamma_identity": None if gamma is None else is_identity(gamma),
            "rotation": ROTATIONS.get(rotation & 15, "unknown") + (", reflected" if rotation & REFLECT else ""),
            "scaled": size != upright or self._transformed(crtc),
        }

    def _transformed(self, crtc: int) -> bool:
        attributes = POINTER(TransformAttributes)()
        if not self._lib.XRRGetCrtcTransform(self._x.handle, crtc, byref(attributes)) or not attributes:
            return False
        current = tuple(attributes.contents.current)
        self._x.lib.XFree(attributes)
        return current != IDENTITY

    def _settings(self, output: int) -> tuple[str, ...]:
        """Describe properties of the output that do not have an accepted value."""
        notes = []
        count = c_int()
        atoms = self._lib.XRRListOutputProperties(self._x.handle, output, byref(count))
        names = [self._x.atom_name(atom) for atom in atoms[: count.value]] if atoms else []
        if atoms:
            self._x.lib.XFree(atoms)
        for name, good in FULL_RANGE.items():
            if name in names:
                raw = self._property(output, name)
                value = self._x.atom_name(int.from_bytes(raw[:8], "little")) if len(raw) >= 8 else ""
                if value and value not in good:
                    notes.append(f"its property '{name}' is '{value}'; '{good[0]}' leaves the pixels unchanged")
        return tuple(notes)

    def _property(self, output: int, name: str) -> bytes:
        """Return the raw value of a property, empty if it has none; Xlib keeps 32-bit items in longs."""
        kind, layout, count, left, data = XID(), c_int(), c_ulong(), c_ulong(), c_void_p()
        atom = self._x.atom(name)
        self._lib.XRRGetOutputProperty(
            *(self._x.handle, output, atom, 0, EDID_LIMIT_LONGS, 0, 0, 0),
            *(byref(kind), byref(layout), byref(count), byref(left), byref(data)),
        )
        if not data:
            return b""
        width = {8: 1, 16: 2, 32: ctypes.sizeof(c_long)}.get(layout.value, 0)
        value = bytes(ctypes.cast(data, POINTER(c_ubyte))[: count.value * width])
        self._x.lib.XFree(data)
        return value


def refresh_hz(mode: ModeInfo) -> float:
    """Return the refresh rate from the timings; 0 where they give none."""
    lines = mode.v_total * (2 if mode.flags & DOUBLE_SCAN else 1) / (2 if mode.flags & INTERLACE else 1)
    return float(mode.dot_clock / (mode.h_total * lines)) if mode.h_total and lines else 0.0


def identity(size: int) -> NDArray[np.uint16]:
    """Return the linear gamma table, (3, size)."""
    return np.tile(np.round(np.linspace(0, 65535, size)).astype(np.uint16), (3, 1))


def is_identity(gamma: NDArray[np.uint16]) -> bool:
    """Return whether a (3, N) gamma table leaves 8-bit values unchanged."""
    error = np.abs(gamma.astype(np.int32) - identity(gamma.shape[1]))
    return bool(error.max() <= GAMMA_TOLERANCE)


def _name(info: OutputInfo) -> str:
    return ctypes.string_at(info.name, info.name_length).decode(errors="replace")
