"""Whether the cameras' exposure suits the colours: each channel's full light, looked at before a long sequence."""

from __future__ import annotations

import numpy as np

from daemon.apps.calibration.guided.capture import Shots
from pipeline.calibrate.color.color_planes import LEAST_PEAK, MAX_SATURATED_SHARE, SATURATION, WHITE_SHARE, planes_of
from pipeline.pattern.sequence import CHANNELS, FrameSequence, Uniform


def full_light(size: tuple[int, int]) -> FrameSequence:
    """Each channel of the projector alone, as bright as it can be."""
    return FrameSequence("full light", tuple(Uniform(size, color) for color in ((255, 0, 0), (0, 255, 0), (0, 0, 255))))


def exposure_problem(shots: Shots) -> str:
    """What is wrong with the exposure under :func:`full_light`; empty when all is well."""
    for side, images in zip(("left", "right"), zip(*shots.pairs, strict=True), strict=True):
        for k, name in enumerate(CHANNELS):
            if images[k].dtype != np.uint8 or shots.encoding == "mono8":
                return f"the cameras send {shots.encoding}; colours need rgb8 or a mosaic of 8 bits"
            plane = planes_of(images[k], shots.encoding)[..., k]
            top = float(np.percentile(plane, 98))
            if top < LEAST_PEAK:
                return (
                    f"{side} camera: full {name} light gives {top:.0f} counts; expose for longer, or open the aperture"
                )
            share = float((plane[plane > WHITE_SHARE * top] >= SATURATION).mean())
            if share > MAX_SATURATED_SHARE:
                return (
                    f"{side} camera: {share:.0%} of the white are clipped under full {name} light; expose for less "
                    "time, close the aperture, or hold the board further away"
                )
    return ""
