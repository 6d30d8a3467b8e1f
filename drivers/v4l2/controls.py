"""A camera's controls by name: their list, and setting them with a note of every deviation.

Names are those of ``v4l2-ctl``: "Exposure Time, Absolute" is ``exposure_time_absolute``. Menus take the number or the
name of an entry, in the same notation.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from drivers.errors import SettingRefused
from drivers.v4l2 import structs as v
from drivers.v4l2.device import Device

ControlValue = bool | int | str
_CONTROLS = 1024
"""Limit of a device's list."""


class Kind(IntEnum):
    """The kinds of control with one 32-bit value."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    BUTTON = 4
    BITMASK = 8
    INTEGER_MENU = 9


_SWITCHES = (Kind.MENU, Kind.BOOLEAN)
"""Set before the others: ``auto_exposure: manual`` must precede the exposure time in any order of options."""


@dataclass(frozen=True, slots=True)
class SupportedControl:
    """A control of a device; ``menu`` has the entries' names by number."""

    id: int
    name: str
    kind: Kind
    minimum: int
    maximum: int
    step: int
    flags: int
    menu: Mapping[int, str] = field(default_factory=dict)

    @property
    def range(self) -> str:
        """Its accepted values, for messages."""
        if self.kind in (Kind.MENU, Kind.INTEGER_MENU):
            return "one of " + ", ".join(f"{name} ({number})" for number, name in self.menu.items())
        if self.kind is Kind.BOOLEAN:
            return "true or false"
        return f"{self.minimum} to {self.maximum}" + (f" in steps of {self.step}" if self.step > 1 else "")

    def number(self, value: ControlValue, name: str) -> int:
        """Return the value for the kernel; SettingRefused for a wrong kind or no entry of the menu."""
        if isinstance(value, str):
            entries = {normalised(text): number for number, text in self.menu.items()}
            key = normalised(value)
            matches = [entry for entry in entries if entry == key] or [e for e in entries if e.split("_")[0] == key]
            if len(matches) != 1:
                raise SettingRefused(f"{name}: {self.name} is {value!r}, expected {self.range}")
            return entries[matches[0]]
        number = int(value)
        if self.menu and number not in self.menu:
            raise SettingRefused(f"{name}: {self.name} is {number}, expected {self.range}")
        return number


def normalised(name: str) -> str:
    """Return letters and digits in lower case, with one underscore for everything between them.

    >>> normalised("White Balance Temperature, Auto")
    'white_balance_temperature_auto'
    """
    parts = "".join(letter.lower() if letter.isascii() and letter.isalnum() else " " for letter in name).split()
    return "_".join(parts)


class Controls:
    """The controls of an open device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self.supported = {control.name: control for control in _enumerate(device)}

    def by_id(self, number: int) -> SupportedControl | None:
        """Return the control of a number of the kernel's headers, None if the device has none."""
        return next((control for control in self.supported.values() if control.id == number), None)

    def get(self, control: SupportedControl) -> int | None:
        """Return the present value, None if it cannot be read."""
        if control.flags & v.CTRL_FLAG_WRITE_ONLY or control.kind is Kind.BUTTON:
            return None
        argument = v.Control(id=control.id)
        try:
            self._device.kernel.ioctl(self._device.fd, v.G_CTRL, argument)
        except OSError as error:
            if error.errno in (errno.ENODEV, errno.ENXIO):
                self._device.fail(error, f"reading the control {control.name}")
            return None
        return int(argument.value)

    def set_all(self, values: Mapping[str, ControlValue]) -> list[str]:
        """Set controls by name.

        Returns:
            A sentence for each one that the device refused or rounded, with its actual value.

        Raises:
            SettingRefused: a name or a menu's entry that the device does not have.
        """
        chosen = [(self._named(name), value) for name, value in values.items()]
        numbers = [(control, control.number(value, self._device.name)) for control, value in chosen]
        numbers.sort(key=lambda pair: pair[0].kind not in _SWITCHES)
        notes = [self._set(control, number) for control, number in numbers]
        return [note for note in notes if note]

    def _named(self, name: str) -> SupportedControl:
        key = normalised(name)
        if key in self.supported:
            return self.supported[key]
        near = difflib.get_close_matches(key, self.supported, 1)
        hint = f"; did you mean {near[0]}?" if near else "."
        names = ", ".join(self.supported) or "none"
        card = self._device.card
        raise SettingRefused(f"{self._device.name}: {card} has no control {name!r}{hint} There are: {names}")

    def _set(self, control: SupportedControl, number: int) -> str:
        try:
            self._device.kernel.ioctl(self._device.fd, v.S_CTRL, v.Control(id=control.id, value=number))
        except OSError as error:
            if error.errno in (errno.ENODEV, errno.ENXIO):
                self._device.fail(error, f"setting the control {control.name}")
            reason = _REASONS.get(error.errno or 0, error.strerror or str(error.errno))
            return f"{control.name}: {number} was refused ({reason}), it is {self._value(control)}; {control.range}"
        actual = self.get(control)
        if actual is not None and actual != number:
            return f"{control.name}: {number} was requested, the camera uses {self._value(control)}; {control.range}"
        inactive = _query(self._device, control.id)
        if inactive is not None and inactive.flags & v.CTRL_FLAG_INACTIVE:
            return f"{control.name}: {number} was set, but another setting (an automatic one) makes it inactive"
        return ""

    def _value(self, control: SupportedControl) -> str:
        value = self.get(control)
        return "unknown" if value is None else control.menu.get(value, str(value))


_REASONS = {
    errno.EACCES: "it is read-only, or controlled by an automatic setting",
    errno.EBUSY: "the camera is busy",
    errno.EINVAL: "the camera refuses this value",
    errno.ERANGE: "out of range",
    errno.EIO: "the camera did not answer",
}


def _query(device: Device, number: int) -> v.QueryControl | None:
    query = v.QueryControl(id=number)
    try:
        device.kernel.ioctl(device.fd, v.QUERY_EXT_CTRL, query)
    except OSError as error:
        if error.errno in (errno.ENODEV, errno.ENXIO):
            device.fail(error, "listing its controls")
        return None
    return query


def _enumerate(device: Device) -> list[SupportedControl]:
    controls: list[SupportedControl] = []
    number = 0
    for _ in range(_CONTROLS):
        query = _query(device, number | v.CTRL_FLAG_NEXT_CTRL)
        if query is None:
            break
        number = query.id
        if query.flags & v.CTRL_FLAG_DISABLED or query.type not in tuple(Kind):
            continue
        kind = Kind(query.type)
        menu = _menu(device, query) if kind in (Kind.MENU, Kind.INTEGER_MENU) else {}
        name = normalised(bytes(query.name).decode("utf-8", "replace"))
        controls.append(
            SupportedControl(number, name, kind, query.minimum, query.maximum, query.step, query.flags, menu)
        )
    return controls


def _menu(device: Device, query: v.QueryControl) -> dict[int, str]:
    """Return the entries by number; a device may leave numbers out."""
    entries: dict[int, str] = {}
    for index in range(max(0, query.minimum), min(query.maximum, 255) + 1):
        entry = v.QueryMenu(id=query.id, index=index)
        try:
            device.kernel.ioctl(device.fd, v.QUERYMENU, entry)
        except OSError:
            continue
        text = bytes(entry.name).decode("utf-8", "replace").strip()
        entries[index] = text if query.type == Kind.MENU else str(entry.value)
    return entries
