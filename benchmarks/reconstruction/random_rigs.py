"""Rigs of random design before the hard scenes: sizes of images, distances, baselines and fringes of every kind.

:func:`benchmarks.reconstruction.cases.random_case` draws scenes and faults for rigs near the standard one. Here the
design itself is drawn, careless ones included: the projector near a camera or where fringe orders repeat, fringes of 6
to 50 camera pixels, walls behind the volume. They show what limits and filters make of rigs they were not fitted to.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.reconstruction.cases import Case
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics

SCENES = ("mixed", "slots", "bars", "steep", "hand", "rims", "cast", "colors", "gloss", "random-{}")
_CAMERAS = ((1024, 820), (1280, 1024), (1024, 768), (1440, 1080), (800, 600))
_PROJECTORS = ((1280, 1024), (1280, 800), (912, 1140), (1920, 1080))


def random_rig(number: int) -> Case:
    """The rig of this number before one of :data:`SCENES`, with random faults."""
    rng = np.random.default_rng([23, number])
    layout, periods = _layout(rng)
    faults = Optics.realistic() if rng.random() < 0.35 else Optics()
    optics = replace(
        faults,
        exposure=float(rng.choice([0.5, 1.0, 1.0, 1.4])),
        noise=float(rng.uniform(0.7, 2.2)),
        ambient=float(rng.uniform(0.01, 0.2)),
        defocus_px=float(rng.uniform(0.5, 2.0)),
        psf_px=float(rng.uniform(0.4, 1.0)),
        crosstalk=float(rng.uniform(0.02, 0.14)),
    )
    scene = SCENES[rng.integers(len(SCENES))].format(number)
    encoding = "bayer_rggb8" if rng.random() < 0.35 else "rgb8"
    return Case(f"rig {number}, {scene}", scene, optics, layout, encoding, periods=periods)


def _layout(rng: np.random.Generator) -> tuple[RigLayout, float]:
    """A layout and its number of fringe periods."""
    standoff = float(rng.uniform(500, 2200))
    size = _CAMERAS[rng.integers(len(_CAMERAS))]
    field = float(rng.uniform(330, 520))
    baseline = standoff * float(rng.uniform(0.12, 0.5))
    fraction = float(rng.choice([rng.uniform(0.1, 0.45), rng.uniform(0.55, 0.9), rng.uniform(0.3, 0.7)]))
    projector = _PROJECTORS[rng.integers(len(_PROJECTORS))]
    focal = projector[0] * standoff / (field * float(rng.uniform(0.95, 1.25)))
    usual = rng.random() < 0.7
    periods = float(np.round(rng.uniform(0.04, 0.11) * projector[0])) if usual else float(rng.uniform(24, 120))
    layout = RigLayout(
        camera_size=size,
        focal_px=size[0] * standoff / field,
        baseline_mm=baseline,
        projector_fraction=fraction,
        projector_up_mm=float(rng.uniform(-80, 150)),
        standoff_mm=standoff,
        projector_size=projector,
        projector_focal_px=focal,
        periods=periods,
        depth_mm=float(rng.uniform(160, 330)),
        lens=float(rng.uniform(0, 2)),
    )
    return layout, periods
