"""Listing of cameras, in a process of its own so that no open camera is disturbed."""

from __future__ import annotations

import logging
import os
import select
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from drivers import child_process
from drivers.errors import DriverError

log = logging.getLogger("fringed.camera")

_MAX_BYTES = 1 << 20
_TIMEOUT_S = 60.0


class DetectedCamera(msgspec.Struct, frozen=True):
    """A camera of a producer; strings are empty where they are not available.

    Args:
        version: of its firmware. transport: ``GEV``, ``U3V``, ``CL``... access: whether it could be opened now.
    """

    vendor: str
    model: str
    serial: str
    user_name: str
    version: str
    transport: str
    producer: str
    access: str


_ACCESS = {1: "free", 2: "read only", 3: "no access", 4: "in use", 5: "open", 6: "open, read only"}


def describe(device: Any) -> DetectedCamera:
    """Describe a device info of harvesters; producers may refuse any property."""
    access = _property(device, "access_status")
    return DetectedCamera(
        vendor=str(_property(device, "vendor") or ""),
        model=str(_property(device, "model") or ""),
        serial=str(_property(device, "serial_number") or ""),
        user_name=str(_property(device, "user_defined_name") or ""),
        version=str(_property(device, "version") or ""),
        transport=str(_property(device, "tl_type") or ""),
        producer=str(_producer(device)),
        access=_ACCESS.get(int(access), "unknown") if access is not None else "unknown",
    )


def discover(producers: Sequence[Path]) -> list[DetectedCamera]:
    """List all cameras of the producers (.cti files).

    Raises:
        FileNotFoundError: a producer does not exist. DriverError: listing failed, or took a minute.
    """
    for path in producers:
        if not path.is_file():
            raise FileNotFoundError(f"there is no GenTL producer {path}")
    reading, writing = os.pipe()
    try:
        process = child_process.start(
            "drivers.genicam.list_cameras", [str(writing), *map(str, producers)], pass_fds=[writing]
        )
    except BaseException:
        os.close(reading)
        raise
    finally:
        os.close(writing)
    output = child_process.OutputReader(process, log, "listing-output")
    try:
        text = _read_all(reading, time.monotonic() + _TIMEOUT_S)
    finally:
        os.close(reading)
        status = child_process.end(process, 1.0)
        output.join(1.0)
    if status != 0 or not text:
        raise DriverError(f"listing cameras failed (exit status {status}): {output.text()}")
    return msgspec.json.decode(text, type=list[DetectedCamera])


def _read_all(fd: int, deadline: float) -> bytes:
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    text = b""
    while poll.poll(max(deadline - time.monotonic(), 0) * 1000):
        part = os.read(fd, 65536)
        if not part or len(text) > _MAX_BYTES:
            return text
        text += part
    return b""


def _property(device: Any, name: str) -> Any:
    from genicam import gentl

    try:
        return getattr(device, name)  # a GenTL device info: a property may raise
    except (gentl.GenericException, AttributeError):
        return None


def _producer(device: Any) -> str:
    from genicam import gentl

    try:
        return str(device.parent.parent.parent.path_name)
    except (gentl.GenericException, AttributeError):
        return ""
