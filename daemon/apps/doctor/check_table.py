"""The table of the checked areas, their order and their functions."""

from __future__ import annotations

import msgspec


class Check(msgspec.Struct, frozen=True):
    """One area.

    Args:
        area: its name. target: ``module:function`` of a function from a Subject to findings.
        drivers: of cameras and projectors that need the check; empty = every rig does.
        needs_rig: whether the check requires a rig.yaml.
        timeout_s: longest duration.
    """

    area: str
    target: str
    drivers: tuple[str, ...] = ()
    needs_rig: bool = False
    timeout_s: float = 30.0


_CAMERAS = ("genicam", "v4l2")

AREAS: tuple[Check, ...] = (
    Check("rig", "daemon.apps.doctor.rig.rig_file:check", needs_rig=True),
    Check("library", "daemon.apps.doctor.cameras.genicam_library:check", ("genicam",), timeout_s=60),
    Check("producers", "daemon.apps.doctor.cameras.genicam_producers:check", ("genicam",), timeout_s=90),
    Check("cameras", "daemon.apps.doctor.cameras.genicam_cameras:check", ("genicam",), timeout_s=150),
    Check("v4l2", "daemon.apps.doctor.cameras.v4l2_cameras:check", ("v4l2",)),
    Check("usb", "daemon.apps.doctor.cameras.usb:check", ("genicam",), timeout_s=150),
    Check("network", "daemon.apps.doctor.cameras.network:check", ("genicam",), timeout_s=150),
    Check("rights", "daemon.apps.doctor.cameras.device_permissions:check", (*_CAMERAS, "x11")),
    Check("files", "daemon.apps.doctor.host.file_permissions:check", needs_rig=True),
    Check("display", "daemon.apps.doctor.rig.display:check", ("x11",), timeout_s=60),
    Check("sockets", "daemon.apps.doctor.host.sockets:check"),
    Check("disk", "daemon.apps.doctor.host.disk:check", timeout_s=60),
    Check("calibration", "daemon.apps.doctor.rig.calibration:check", needs_rig=True, timeout_s=60),
    Check("timing", "daemon.apps.doctor.rig.exposure_timing:check", _CAMERAS, needs_rig=True, timeout_s=60),
    Check("processors", "daemon.apps.doctor.host.processors:check", timeout_s=90),
    Check("memory", "daemon.apps.doctor.host.memory:check"),
    Check("clock", "daemon.apps.doctor.host.clock:check"),
    Check("service", "daemon.apps.doctor.host.service:check"),
)
