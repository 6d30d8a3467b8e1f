"""Rigs of random design before the hard scenes: sizes of images, distances, baselines and fringes of every kind.

:func:`benchmarks.reconstruction.cases.random_case` draws scenes and faults for rigs near the standard one. Here the
design itself is drawn, careless ones included: the projector near a camera or where fringe orders repeat, fringes of 6
to 50 camera pixels, walls behind the volume. They show what limits and filters make of rigs they were not fitted to.
"""

from __future__ import annotations

import numpy as np

from benchmarks.reconstruction.cases import Case, random_optics
from sim.rig.layout import RigLayout

SCENES = ("mixed", "slots", "bars", "steep", "hand", "rims", "cast", "colors", "gloss", "random-{}")
_CAMERAS = ((1024, 820), (1280, 1024), (1024, 768), (1440, 1080), (800, 600))
_PROJECTORS = ((1280, 1024), (1280, 800), (912, 1140), (1920, 1080))


def random_rig(number: int) -> Case:
    """The rig of this number before one of :data:`SCENES`, with random faults."""
    rng = np.random.default_rng([23, number])
    layout = _layout(rng)
    optics = random_optics(
        rng, realistic=0.35, noise=2.2, ambient=0.2, defocus_px=2.0, psf_px=1.0, crosstalk=0.14
    )  # fmt: skip
    scene = SCENES[rng.integers(len(SCENES))].format(number)
    encoding = "bayer_rggb8" if rng.random() < 0.35 else "rgb8"
    return Case(f"rig {number}, {scene}", scene, optics, layout, encoding, periods=layout.periods)


def _layout(rng: np.random.Generator) -> RigLayout:
    """Cameras, projector, fringes and volume."""
    standoff = rng.uniform(500, 2200)
    size = _CAMERAS[rng.integers(len(_CAMERAS))]
    field = rng.uniform(330, 520)
    baseline = standoff * rng.uniform(0.12, 0.5)
    fraction = float(rng.choice([rng.uniform(0.1, 0.45), rng.uniform(0.55, 0.9), rng.uniform(0.3, 0.7)]))
    projector = _PROJECTORS[rng.integers(len(_PROJECTORS))]
    focal = projector[0] * standoff / (field * rng.uniform(0.95, 1.25))
    usual = rng.random() < 0.7
    periods = float(np.round(rng.uniform(0.04, 0.11) * projector[0])) if usual else rng.uniform(24, 120)
    return RigLayout(
        camera_size=size,
        focal_px=size[0] * standoff / field,
        baseline_mm=baseline,
        projector_fraction=fraction,
        projector_up_mm=rng.uniform(-80, 150),
        standoff_mm=standoff,
        projector_size=projector,
        projector_focal_px=focal,
        periods=periods,
        depth_mm=rng.uniform(160, 330),
        lens=rng.uniform(0, 2),
    )
