"""Compatibility of devices and files: sizes, and exposures against the projector's period."""

from __future__ import annotations

from collections.abc import Mapping

from daemon.live.acquisition.camera_status import CameraStatus
from drivers.protocols import ProjectorInfo, Side
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration

_WHOLE = 0.01
"""How far an exposure may be off a whole number of the projector's periods, in periods."""


def size_problem(camera: Side, size: tuple[int, int], calibration: Calibration) -> str:
    """Why a camera's images do not fit the calibration; empty where they do."""
    calibrated = (calibration.left if camera == "left" else calibration.right).size
    if not any(size) or tuple(size) == tuple(calibrated):
        return ""
    return (
        f"camera {camera} sends {size[0]} x {size[1]} pixels, "
        f"the calibration is for {calibrated[0]} x {calibrated[1]}; set its region to that size or calibrate again"
    )


def projector_problem(projector: ProjectorInfo, pattern: ColorFringe) -> str:
    """Why a projector cannot show a pattern pixel by pixel; empty where it can."""
    if tuple(projector.size) == tuple(pattern.size):
        return ""
    return (
        f"projector {projector.output} shows {projector.size[0]} x {projector.size[1]} pixels, the pattern has "
        f"{pattern.size[0]} x {pattern.size[1]}; choose that mode, or calibrate with this projector"
    )


def timing_warnings(refresh_hz: float, cameras: Mapping[str, CameraStatus]) -> list[str]:
    """Warnings about exposures that are no whole number of the projector's periods.

    A projector shows its colours one after the other, so that any other exposure weights them by chance. There is no
    warning where the refresh rate or the exposure is unknown.
    """
    if refresh_hz <= 0:
        return []
    period_us = 1e6 / refresh_hz
    warnings = []
    for side, camera in cameras.items():
        periods = camera.exposure_us / period_us
        whole = max(1, round(periods))
        if camera.exposure_us > 0 and abs(periods - whole) > _WHOLE:
            warnings.append(
                f"camera {side} exposes for {camera.exposure_us:.0f} us, which is {periods:.3f} periods of the "
                f"projector ({refresh_hz:.3f} Hz); {whole * period_us:.0f} us are {whole}"
            )
    return warnings
