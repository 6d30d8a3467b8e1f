"""A camera's features by name: whether they are there, what they take, and what they took.

Cameras differ in which features they have and what they call them, so every access asks first. Names are those of the
SFNC (GenICam Standard Features Naming Convention); older names stand in a table.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from genicam import genapi, gentl

from drivers.errors import DeviceLost, SettingRefused

ALIASES: dict[str, tuple[str, ...]] = {
    "ExposureTime": ("ExposureTimeAbs",),
    "Gain": ("GainAbs", "GainRaw"),
    "TriggerDelay": ("TriggerDelayAbs",),
    "AcquisitionFrameRate": ("AcquisitionFrameRateAbs",),
    "AcquisitionFrameRateEnable": ("AcquisitionFrameRateEnabled",),
    "TimestampLatch": ("GevTimestampControlLatch", "TimestampControlLatch"),
    "TimestampLatchValue": ("GevTimestampValue", "TimestampValue"),
    "TimestampTickFrequency": ("GevTimestampTickFrequency", "DeviceTimestampFrequency"),
    "DeviceTemperature": ("DeviceTemperatureRaw", "SensorTemperature"),
    "TriggersMissed": ("MissedTriggerCount", "TriggerMissedCount", "StatMissedTriggers"),
}
"""What older or stubborn cameras call a feature."""

_READABLE = {3, 4}
_WRITABLE = {2, 4}
_THERE = _READABLE | _WRITABLE

GENICAM_ERRORS = (genapi.GenericException, gentl.GenericException)
LOSS = (gentl.IoException, gentl.InvalidHandleException, gentl.ClosedException, gentl.NotInitializedException)
"""What a producer raises when the camera is gone."""


@contextmanager
def losses(doing: str) -> Iterator[None]:
    """Errors of a camera that is gone become DeviceLost."""
    try:
        yield
    except LOSS as error:
        raise DeviceLost(f"the camera is gone ({doing}): {error}") from error


class Features:
    """The features of one node map.

    Args:
        nodes: of the camera or of the data stream, None where there is no such map.
    """

    def __init__(self, nodes: Any) -> None:
        self._nodes = nodes

    def find(self, name: str) -> Any:
        """The node of that name, or of an older one, None if it is not there now."""
        if self._nodes is None:
            return None
        for known in (name, *ALIASES.get(name, ())):
            try:
                if self._nodes.has_node(known):
                    node = getattr(self._nodes, known, None)
                    if node is not None and int(node.get_access_mode()) in _THERE:
                        return node
            except LOSS:
                raise
            except GENICAM_ERRORS:
                continue
        return None

    def name(self, name: str) -> str:
        """What this camera calls the feature."""
        node = self.find(name)
        return name if node is None else str(node.node.name)

    def writable(self, name: str) -> bool:
        """Whether it can be written now."""
        node = self.find(name)
        return node is not None and int(node.get_access_mode()) in _WRITABLE

    def read(self, name: str) -> Any:
        """Its value, None if there is none to read."""
        node = self.find(name)
        if node is None or int(node.get_access_mode()) not in _READABLE:
            return None
        try:
            return node.value
        except LOSS:
            raise
        except GENICAM_ERRORS:
            return None

    # A GenICam node has the members of its interface alone: ``entries`` of an enumeration, ``min`` and ``max`` of a
    # number, ``execute`` of a command. Hence the hasattr of the methods below.

    def choices(self, name: str) -> tuple[str, ...]:
        """The entries of an enumeration that can be chosen now."""
        node = self.find(name)
        if node is None or not hasattr(node, "entries"):
            return ()
        return tuple(str(entry.symbolic) for entry in node.entries if int(entry.get_access_mode()) in _THERE)

    def limits(self, name: str) -> tuple[float, float] | None:
        """The smallest and largest value of a number, None if it tells none."""
        node = self.find(name)
        try:
            return (node.min, node.max) if node is not None and hasattr(node, "min") else None
        except GENICAM_ERRORS:
            return None

    def write(self, name: str, value: Any) -> Any:
        """Set a feature; returns the value that it has then.

        Numbers outside the limits are brought inside, whole numbers onto the steps: the caller compares.

        Raises:
            SettingRefused: it is not there, locked, or does not know the value.
        """
        node = self.find(name)
        if node is None:
            raise SettingRefused(f"{name} cannot be set to {value}: this camera has no such feature")
        if int(node.get_access_mode()) not in _WRITABLE:
            raise SettingRefused(f"{name} cannot be set to {value}: it is read-only now ({self.read(name)})")
        try:
            node.value = self._fitted(node, value)
            return node.value if int(node.get_access_mode()) in _READABLE else value
        except LOSS:
            raise
        except (*GENICAM_ERRORS, TypeError, ValueError) as error:
            raise SettingRefused(f"{name} cannot be set to {value}: {self._allowed(name) or error}") from error

    def execute(self, name: str) -> bool:
        """Run a command; False if there is none of that name."""
        node = self.find(name)
        if node is None or not hasattr(node, "execute"):
            return False
        node.execute()
        return True

    def _allowed(self, name: str) -> str:
        if choices := self.choices(name):
            return f"there are {', '.join(choices)}"
        limits = self.limits(name)
        return f"{limits[0]:g} to {limits[1]:g} are possible" if limits is not None else ""

    @staticmethod
    def _fitted(node: Any, value: Any) -> Any:
        """A number brought between the limits and, if whole, onto the steps."""
        if isinstance(value, bool | str) or not hasattr(node, "min"):
            return value
        low, high = node.min, node.max
        value = min(max(value, low), high)
        if isinstance(node, genapi.IInteger):
            step = max(int(node.inc), 1)
            return int(low) + (int(value) - int(low)) // step * step
        return float(value)
