"""Exposures against the projector's period: any other than a whole number of periods weighs its colours by chance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.live.acquisition.camera_status import CameraState, CameraStatus
from daemon.live.compatibility import timing_warnings

area = Area("timing")

_V4L2_EXPOSURES = "exposure_time_absolute", "exposure_absolute"
_V4L2_UNIT_US = 100.0


def check(subject: Subject) -> Iterator[Finding]:
    """The exposures that rig.yaml sets, and the refresh rate of the projector."""
    exposures = {side: exposure_us(options) for side, options in subject.cameras.items()}
    for side, exposure in exposures.items():
        if exposure <= 0:
            text = f"rig.yaml sets no exposure of camera {side}: it is what the camera was left with"
            yield area.warning(
                "exposure", text, f"set {_key(subject, side)} to a whole number of the projector's periods"
            )
    yield from judged(subject.refresh_hz, exposures)


def exposure_us(options: Any) -> float:
    """The exposure that a camera's options ask for, microseconds, 0 if none."""
    asked = getattr(options, "exposure_us", None)
    if asked is not None:
        return float(asked)
    controls = getattr(options, "controls", {})
    value = next((controls[name] for name in _V4L2_EXPOSURES if name in controls), 0)
    return float(value) * _V4L2_UNIT_US if isinstance(value, int) else 0.0


def judged(refresh_hz: float, exposures: dict[Any, float]) -> Iterator[Finding]:
    """Whether the exposures suit the rate and each other."""
    known = {side: exposure for side, exposure in exposures.items() if exposure > 0}
    if len(set(known.values())) > 1:
        text = " and ".join(f"{side} {exposure:.0f} us" for side, exposure in known.items())
        yield area.warning("exposure", f"the cameras expose for different times: {text}", "set both to one exposure")
    if refresh_hz <= 0:
        remedy = "set projector.options.refresh_hz to the projector's frame rate"
        yield area.note(
            "refresh", "the projector's refresh rate is unknown, exposures cannot be compared with it", remedy
        )
        return
    cameras = {side: CameraStatus(CameraState.CLOSED, exposure_us=exposure) for side, exposure in known.items()}
    wrong = timing_warnings(refresh_hz, cameras)
    for text in wrong:
        what, _, _ = text.partition("; ")
        side = what.split()[1]
        periods = max(1, round(known[side] * refresh_hz / 1e6))
        whole = periods * 1e6 / refresh_hz
        yield area.warning("exposure", what, f"expose for {whole:.0f} us, {periods} whole period{'s'[: periods > 1]}")
    if known and not wrong:
        longest = max(known.values())
        yield area.ok(
            "exposure", f"{longest:.0f} us are {longest * refresh_hz / 1e6:.2f} periods of {refresh_hz:.3f} Hz"
        )


def _key(subject: Subject, side: str) -> str:
    own = "exposure_us" if subject.uses("genicam") else f"controls.{_V4L2_EXPOSURES[0]}"
    return f"cameras.{side}.{own}"
