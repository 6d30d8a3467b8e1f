"""The table of areas: what is looked at, in which order, and by which function."""

from __future__ import annotations

import msgspec


class Check(msgspec.Struct, frozen=True):
    """One area.

    Args:
        area: its name. target: ``module:function`` of a function from a Subject to findings.
        drivers: the drivers of cameras and projectors that need it; empty = every rig does.
        needs_rig: whether there is nothing to look at without a rig.yaml.
        timeout_s: after so long it is ended.
    """

    area: str
    target: str
    drivers: tuple[str, ...] = ()
    needs_rig: bool = False
    timeout_s: float = 30.0


_CAMERAS = ("genicam", "v4l2")

AREAS: tuple[Check, ...] = (
    Check("rig", "daemon.doctor.rig_file:check", needs_rig=True),
    Check("library", "daemon.doctor.genicam_library:check", ("genicam",), timeout_s=60),
    Check("producers", "daemon.doctor.producers:check", ("genicam",), timeout_s=90),
    Check("cameras", "daemon.doctor.genicam_cameras:check", ("genicam",), timeout_s=150),
    Check("v4l2", "daemon.doctor.v4l2_cameras:check", ("v4l2",)),
    Check("usb", "daemon.doctor.usb:check", ("genicam",), timeout_s=150),
    Check("network", "daemon.doctor.network:check", ("genicam",), timeout_s=150),
    Check("rights", "daemon.doctor.rights:check", (*_CAMERAS, "x11")),
    Check("files", "daemon.doctor.files:check", needs_rig=True),
    Check("display", "daemon.doctor.display:check", ("x11",), timeout_s=60),
    Check("sockets", "daemon.doctor.sockets:check"),
    Check("disk", "daemon.doctor.disk:check", timeout_s=60),
    Check("calibration", "daemon.doctor.calibration:check", needs_rig=True, timeout_s=60),
    Check("timing", "daemon.doctor.timing:check", _CAMERAS, needs_rig=True, timeout_s=60),
    Check("processors", "daemon.doctor.processors:check", timeout_s=90),
    Check("memory", "daemon.doctor.memory:check"),
    Check("clock", "daemon.doctor.clock:check"),
    Check("service", "daemon.doctor.service:check"),
)
