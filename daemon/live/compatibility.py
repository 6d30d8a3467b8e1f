"""Whether the devices suit each other and the files: sizes, and exposures against the projector's period."""

from __future__ import annotations

from collections.abc import Mapping

from daemon.live.acquisition.camera_status import CameraStatus
from drivers.protocols import ProjectorInfo, Side
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration

_WHOLE = 0.01
"""How far an exposure may be off a whole number of the projector's periods, in periods."""


def size_problem(camera: Side, size: tuple[int, int], calibration: Calibration) -> str:
    """Why the images of a camera cannot be measured with a calibration, or nothing."""
    known = (calibration.left if camera == "left" else calibration.right).size
    if not any(size) or tuple(size) == tuple(known):
        return ""
    return (
        f"camera {camera} sends {size[0]} x {size[1]} pixels, the calibration is for {known[0]} x {known[1]}; "
        f"set its region to that size or calibrate again"
    )


def projector_problem(projector: ProjectorInfo, pattern: ColorFringe) -> str:
    """Why a projector cannot show a pattern pixel by pixel, or nothing."""
    if tuple(projector.size) == tuple(pattern.size):
        return ""
    return (
        f"projector {projector.output} shows {projector.size[0]} x {projector.size[1]} pixels, the pattern has "
        f"{pattern.size[0]} x {pattern.size[1]}; choose that mode, or calibrate with this projector"
    )


def timing_warnings(refresh_hz: float, cameras: Mapping[str, CameraStatus]) -> list[str]:
    """What to say of exposures that are no whole number of the projector's periods.

    A projector makes its colours one after the other, so that any other exposure weighs them by chance. Nothing is said
    where the refresh rate or the exposure is unknown.
    """
    if refresh_hz <= 0:
        return []
    period_us = 1e6 / refresh_hz
    found = []
    for side, camera in cameras.items():
        periods = camera.exposure_us / period_us
        whole = max(1, round(periods))
        if camera.exposure_us > 0 and abs(periods - whole) > _WHOLE:
            found.append(
                f"camera {side} exposes for {camera.exposure_us:.0f} us, which is {periods:.3f} periods of the "
                f"projector ({refresh_hz:.3f} Hz); {whole * period_us:.0f} us are {whole}"
            )
    return found
