"""Quality of a colour session: exposure, gains, additivity of the light, agreement of the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.color_planes import View
from pipeline.calibrate.color.color_sequence import Roles
from pipeline.calibrate.color.tone_response import LevelCurve
from pipeline.pattern.projected_frames import CHANNELS
from pipeline.rig.calibration import Response

Array = NDArray[np.float64]

GOOD_PEAK = (180.0, 245.0)
UNEVEN_BALANCE = 1.25
DISAGREEMENT = 0.01


def peak_of(view: View, crosstalk: Array) -> float:
    """Counts that the brightest part of the white area will have at the standard colour fringe's peak."""
    top = np.percentile(view.full[view.area], 98, axis=0)
    lights = np.where(np.eye(3, dtype=bool), 245.5, 68.5) / 255
    return float((view.black[view.area].mean(axis=0) + (lights * top) @ crosstalk.T).max())


def additivity_of(view: View, roles: Roles, response: Response, crosstalk: Array) -> float | None:
    """White light over the sum of its colours, 1 unless the projector adds white; None when white is clipped."""
    for index, level in roles.white:
        if view.images.saturated(index, view.area).max() > 0.001:
            continue
        white = (view.images.planes(index) - view.black)[view.area].mean(axis=0, dtype=np.float64)
        light = response.light(np.full((1, 3), float(level)))[0] / 255
        expected = crosstalk @ (light * view.full[view.area].mean(axis=0, dtype=np.float64))
        return float(white.sum() / expected.sum())
    return None


def projector_quality(response: Response, curves: Sequence[Sequence[LevelCurve]]) -> dict[str, Any]:
    """Noise of the response, and the exponents at its middle."""
    inner = slice(1, -1)
    sigma = max(float(c.sigma[inner].max()) for seen in curves for c in seen) if len(curves[0][0].levels) > 2 else 0.0
    middle = response.light(np.full((1, 3), 127.5))[0] / 255
    gamma = np.log(np.maximum(middle, 1e-6)) / np.log(0.5)
    return {"response_sigma": sigma, "gamma": dict(zip(CHANNELS, gamma.round(4).tolist(), strict=True))}


def disagreement_of(curves: Sequence[Sequence[LevelCurve]], passes: int, quality: dict[str, Any]) -> list[str]:
    """Difference of the cameras' responses, written into ``quality``; a sentence if it exceeds the limit."""
    differences = []
    for seen in curves:
        left, right = (np.mean([c.light for c in part], axis=0) for part in (seen[:passes], seen[passes:]))
        differences.append(float(np.abs(left - right).max()))
    quality["response_disagreement"] = max(differences)
    if max(differences) <= DISAGREEMENT:
        return []
    return [
        f"the cameras differ by {max(differences):.3f} about the light of {CHANNELS[int(np.argmax(differences))]} "
        f"(limit {DISAGREEMENT}): make the exposure a whole number of the projector's colour cycles, the same in both "
        "cameras"
    ]


def exposure_recommendations(side: str, counts: Array, peak: float) -> list[str]:
    """Recommended changes of a camera's exposure and gains; counts (3,) of each channel's own full light."""
    out = []
    if not GOOD_PEAK[0] <= peak <= GOOD_PEAK[1]:
        change = "lengthen" if peak < GOOD_PEAK[0] else "shorten"
        out.append(
            f"{side} camera: the white board peaks at {peak:.0f} counts, {GOOD_PEAK[0]:.0f} to {GOOD_PEAK[1]:.0f} are "
            f"best; {change} the exposure"
        )
    if counts.max() / counts.min() > UNEVEN_BALANCE:
        weak = CHANNELS[int(counts.argmin())]
        gains = ", ".join(f"{n} x {counts.max() / c:.2f}" for n, c in zip(CHANNELS, counts, strict=True))
        out.append(
            f"{side} camera: {weak} is the weakest channel; fixed gains ({gains}) in the camera or a weaker light of "
            "the other colours in the projector would even them out"
        )
    return out
