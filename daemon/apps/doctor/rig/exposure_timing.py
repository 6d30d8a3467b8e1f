"""Exposures and the projector's period: a fraction of a period weights the colours unevenly."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import CameraOptions, Subject
from daemon.live.acquisition.camera_status import CameraState, CameraStatus
from daemon.live.compatibility import timing_warnings
from drivers.genicam.options import Options as GenicamOptions
from drivers.protocols import Side

area = Area("timing")

_V4L2_EXPOSURES = "exposure_time_absolute", "exposure_absolute"
_V4L2_UNIT_US = 100.0


def check(subject: Subject) -> Iterator[Finding]:
    """Compare the exposures of rig.yaml with the projector's refresh rate."""
    exposures = {side: exposure_us(options) for side, options in subject.cameras.items()}
    for side, exposure in exposures.items():
        if exposure <= 0:
            text = f"rig.yaml sets no exposure of camera {side}, the camera keeps its previous one"
            yield area.warning(
                "exposure", text, f"set {_key(subject, side)} to a whole number of the projector's periods"
            )
    yield from exposure_findings(subject.refresh_hz, exposures)


def exposure_us(options: CameraOptions) -> float:
    """The exposure in a camera's options, microseconds, 0 if none."""
    if isinstance(options, GenicamOptions):
        return options.exposure_us or 0.0
    value = next((options.controls[name] for name in _V4L2_EXPOSURES if name in options.controls), 0)
    return float(value) * _V4L2_UNIT_US if isinstance(value, int) else 0.0


def exposure_findings(refresh_hz: float, exposures: dict[Side, float]) -> Iterator[Finding]:
    """Compare the exposures with the refresh rate and with each other."""
    known = {side: exposure for side, exposure in exposures.items() if exposure > 0}
    if len(set(known.values())) > 1:
        text = " and ".join(f"{side} {exposure:.0f} us" for side, exposure in known.items())
        yield area.warning("exposure", f"the cameras have different exposures: {text}", "set both to the same exposure")
    if refresh_hz <= 0:
        remedy = "set projector.options.refresh_hz to the projector's frame rate"
        yield area.note("refresh", "the projector's refresh rate is unknown, so the exposures are not checked", remedy)
        return
    cameras = {str(side): CameraStatus(CameraState.CLOSED, exposure_us=us) for side, us in known.items()}
    wrong = timing_warnings(refresh_hz, cameras)
    for text in wrong:
        problem, _, _ = text.partition("; ")
        side: Side = "left" if problem.split()[1] == "left" else "right"
        periods = max(1, round(known[side] * refresh_hz / 1e6))
        whole = periods * 1e6 / refresh_hz
        yield area.warning(
            "exposure", problem, f"expose for {whole:.0f} us, {periods} whole period{'s'[: periods > 1]}"
        )
    if known and not wrong:
        longest = max(known.values())
        yield area.ok(
            "exposure", f"{longest:.0f} us are {longest * refresh_hz / 1e6:.2f} periods of {refresh_hz:.3f} Hz"
        )


def _key(subject: Subject, side: str) -> str:
    key = "exposure_us" if subject.uses("genicam") else f"controls.{_V4L2_EXPOSURES[0]}"
    return f"cameras.{side}.{key}"
