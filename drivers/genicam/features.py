"""A camera's features by name: whether they exist, their limits, and their values.

Cameras differ in their features and their names, so every access checks first. Names are those of the SFNC (GenICam
Standard Features Naming Convention); a table lists older ones.
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
"""Other names of a feature, in older cameras or against the convention."""

_READABLE = {3, 4}
_WRITABLE = {2, 4}
_AVAILABLE = _READABLE | _WRITABLE

GENICAM_ERRORS = (genapi.GenericException, gentl.GenericException)
LOSS = (gentl.IoException, gentl.InvalidHandleException, gentl.ClosedException, gentl.NotInitializedException)
"""Errors of a producer when the camera is gone."""


@contextmanager
def device_lost_errors(action: str) -> Iterator[None]:
    """Convert the errors of a camera that is gone to DeviceLost."""
    try:
        yield
    except LOSS as error:
        raise DeviceLost(f"the camera is gone ({action}): {error}") from error


class Features:
    """The features of one node map.

    Args:
        nodes: of the camera or of the data stream, None where there is no such map.
    """

    def __init__(self, nodes: Any) -> None:
        self._nodes = nodes

    def find(self, name: str) -> Any:
        """Return the node of that name, or of an older one, None if it is not available now."""
        if self._nodes is None:
            return None
        for alias in (name, *ALIASES.get(name, ())):
            try:
                if self._nodes.has_node(alias):
                    node = getattr(self._nodes, alias, None)  # a GenICam node map has its nodes as attributes
                    if node is not None and int(node.get_access_mode()) in _AVAILABLE:
                        return node
            except LOSS:
                raise
            except GENICAM_ERRORS:
                continue
        return None

    def name(self, name: str) -> str:
        """Return the feature's name in this camera."""
        node = self.find(name)
        return name if node is None else str(node.node.name)

    def writable(self, name: str) -> bool:
        """Return whether it can be written now."""
        node = self.find(name)
        return node is not None and int(node.get_access_mode()) in _WRITABLE

    def read(self, name: str) -> Any:
        """Return its value, None if it cannot be read."""
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
        """Return the entries of an enumeration that are available now."""
        node = self.find(name)
        if node is None or not hasattr(node, "entries"):
            return ()
        return tuple(str(entry.symbolic) for entry in node.entries if int(entry.get_access_mode()) in _AVAILABLE)

    def limits(self, name: str) -> tuple[float, float] | None:
        """Return the smallest and largest value of a number, None if it has no limits."""
        node = self.find(name)
        try:
            return (node.min, node.max) if node is not None and hasattr(node, "min") else None
        except GENICAM_ERRORS:
            return None

    def write(self, name: str, value: Any) -> Any:
        """Set a feature; return the value that it has then.

        Numbers are clamped to the limits, whole numbers rounded to the steps: the caller compares.

        Raises:
            SettingRefused: it does not exist, is locked, or refuses the value.
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
        """Execute a command; False if there is none of that name."""
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
        """Return a number clamped to the limits and, if whole, rounded to the steps."""
        if isinstance(value, bool | str) or not hasattr(node, "min"):
            return value
        low, high = node.min, node.max
        value = min(max(value, low), high)
        if isinstance(node, genapi.IInteger):
            step = max(int(node.inc), 1)
            return int(low) + (int(value) - int(low)) // step * step
        return float(value)
