"""Serial numbers of the two cameras: of a calibration, of a take, of images, of the connected devices.

They reveal exchanged or replaced cameras. An unknown number is not compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from daemon.common.errors import InputError
from drivers.protocols import SIDES, Side

Serials = Mapping[Side, str]


def serials_in(cameras: Mapping[str, Any]) -> dict[Side, str]:
    """The numbers in ``cameras`` of a calibration file."""
    found = {side: (cameras.get(side) or {}).get("serial") for side in SIDES}
    return {side: str(serial) for side, serial in found.items() if serial}


def take_metadata(serials: Serials) -> dict[str, str]:
    """The keys of a take's record ``fringed``: ``serial_left`` and ``serial_right``."""
    return {f"serial_{side}": serial for side, serial in serials.items() if serial}


def serials_of_take(metadata: Mapping[str, str]) -> dict[Side, str]:
    """The numbers in a take's record ``fringed``."""
    return {side: metadata[f"serial_{side}"] for side in SIDES if metadata.get(f"serial_{side}")}


def serial_problem(calibrated: Serials, devices: Serials) -> str:
    """Why cameras are not those that were calibrated; empty where nothing contradicts it."""
    differ = [
        side for side in SIDES if calibrated.get(side) and devices.get(side, calibrated[side]) != calibrated[side]
    ]
    differ = [side for side in differ if devices[side]]
    if not differ:
        return ""
    if len(differ) == 2 and calibrated["left"] == devices["right"] and calibrated["right"] == devices["left"]:
        return (
            f"the cameras are exchanged: left is {devices['left']} and right is {devices['right']}, in the calibration "
            "it is the opposite; exchange cameras.left and cameras.right in rig.yaml, or calibrate again"
        )
    named = ", ".join(f"camera {side} is {devices[side]}, calibrated was {calibrated[side]}" for side in differ)
    return f"{named}; connect the calibrated camera or calibrate again"


def common_serials(sources: Iterable[tuple[str, Serials]]) -> dict[Side, str]:
    """The numbers that all sources agree on, each with its name.

    Raises:
        InputError: images of two different cameras on one side.
    """
    found: dict[Side, tuple[str, str]] = {}
    for name, serials in sources:
        for side, serial in serials.items():
            before, first = found.setdefault(side, (serial, name))
            if serial != before:
                raise InputError(
                    f"{name}: its {side} images are of camera {serial}, those of {first} are of camera {before}; "
                    "all sources of a calibration need the same cameras on the same sides"
                )
    return {side: serial for side, (serial, _) in found.items()}
