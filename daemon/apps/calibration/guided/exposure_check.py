"""A check of the exposure before the long colour sequence, with the full light of each channel."""

from __future__ import annotations

import numpy as np

from daemon.apps.calibration.guided.capture import CapturedImages
from pipeline.calibrate.color.color_planes import LEAST_PEAK, MAX_SATURATED_SHARE, SATURATION, WHITE_SHARE, planes_of
from pipeline.pattern.projected_frames import CHANNELS, Uniform
from pipeline.pattern.sequence import FrameSequence


def full_light(size: tuple[int, int]) -> FrameSequence:
    """A sequence of each projector channel alone at its maximum."""
    return FrameSequence("full light", tuple(Uniform(size, color) for color in ((255, 0, 0), (0, 255, 0), (0, 0, 255))))


def exposure_problem(captured: CapturedImages) -> str:
    """The problem of the exposure under :func:`full_light`; empty if there is none."""
    for side, images in zip(("left", "right"), zip(*captured.pairs, strict=True), strict=True):
        for k, name in enumerate(CHANNELS):
            if images[k].dtype != np.uint8 or captured.encoding == "mono8":
                return f"the cameras send {captured.encoding}; colours need rgb8 or a mosaic of 8 bits"
            plane = planes_of(images[k], captured.encoding)[..., k]
            top = float(np.percentile(plane, 98))
            if top < LEAST_PEAK:
                return (
                    f"{side} camera: full {name} light gives {top:.0f} counts; increase the exposure time, or open "
                    "the aperture"
                )
            share = float((plane[plane > WHITE_SHARE * top] >= SATURATION).mean())
            if share > MAX_SATURATED_SHARE:
                return (
                    f"{side} camera: {share:.0%} of the white pixels are saturated under full {name} light; reduce "
                    "the exposure time, close the aperture, or move the board further away"
                )
    return ""
