"""The cases: scenes, rigs and faults, each with the limits that it must keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.common.settings import Settings
from pipeline.pattern.color_fringe import ColorFringe, modulated_profile
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.render.render_pair import RenderedPair, render_pair
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table.

    Args:
        name: of the row; scene: of the simulator.
        optics: light and sensor; layout: of the rig; encoding: of the sensor.
        modulated: frequency-modulated fringes instead of equal ones.
        promise: least reconstructed share, largest wrong share, largest rms in mm; None = shown only.
    """

    name: str
    scene: str
    optics: Optics = field(default_factory=Optics)
    layout: RigLayout = field(default_factory=RigLayout)
    encoding: str = "rgb8"
    modulated: bool = False
    periods: float = 96.0
    promise: tuple[float, float, float] | None = None

    def render(self, seed: int = 0) -> RenderedPair:
        """The images of this case with their truth."""
        return render_pair(
            self.layout, build(self.scene, seed=seed), self.pattern, self.optics, 0.0, seed, self.encoding
        )

    @property
    def pattern(self) -> ColorFringe:
        """What the projector shows."""
        plain = self.layout.pattern(self.periods)
        if not self.modulated:
            return plain
        return replace(plain, profile=modulated_profile(plain.length, plain.periods))

    def reconstructor(self, settings: Settings | None = None, clock: Callable[[], int] | None = None) -> Reconstructor:
        """A reconstructor with the rig's calibration."""
        calibration = self.layout.calibration_for(self.optics)
        return Reconstructor(
            calibration, self.pattern, self.layout.volume(), encoding=self.encoding, settings=settings, clock=clock
        )


STANDARD = (0.97, 0.0015, 0.090)
REALISTIC = (0.965, 0.002, 0.085)
MIDDLE = RigLayout(projector_fraction=0.5)
WIDE = RigLayout(
    camera_size=(1024, 768), focal_px=2297.0, baseline_mm=302.0, projector_fraction=0.59, projector_up_mm=20.0,
    standoff_mm=1250.0, projector_focal_px=2240.0, periods=32.0, depth_mm=500.0,
)  # fmt: skip
"""Short lenses and fringes of 41 pixels, as in the public data set of a bust."""
CLOSE = RigLayout(
    camera_size=(1280, 1024), focal_px=3386.0, baseline_mm=286.0, projector_fraction=0.372, projector_up_mm=103.0,
    standoff_mm=894.0, projector_size=(1920, 1080), projector_focal_px=4563.0, periods=73.0, depth_mm=238.0, lens=1.8,
)  # fmt: skip
FAR = RigLayout(
    camera_size=(1024, 768), focal_px=4722.0, baseline_mm=249.0, projector_fraction=0.759, projector_up_mm=126.0,
    standoff_mm=1568.0, projector_focal_px=5049.0, periods=84.0, depth_mm=266.0, lens=1.25,
)  # fmt: skip
"""Both see parts of the cast's wall with one camera only, whose orders then agree with another part of the wall."""

CASES = (
    Case("all at once", "mixed", promise=STANDARD),
    Case("bare white plane", "plane", promise=STANDARD),
    Case("spheres", "spheres"),
    Case("steps", "steps"),
    Case("face", "face"),
    Case("isolated objects", "isolated"),
    Case("realistic, Bayer", "mixed", Optics.realistic(), encoding="bayer_rggb8", promise=REALISTIC),
    Case("standard, Bayer", "mixed", encoding="bayer_rggb8"),
    Case("projector off by one column", "mixed", Optics(projector_error_px=(1.0, 0.0))),
    Case("projector in the middle", "mixed", layout=MIDDLE),
    Case("the same, modulated fringes", "mixed", layout=MIDDLE, modulated=True),
    Case("N = 64", "mixed", periods=64.0),
    Case("N = 128", "mixed", periods=128.0),
    Case("over-exposed 1.8 times", "mixed", Optics(exposure=1.8)),
    Case("noise x 4", "mixed", Optics(noise=4.0)),
    Case("gamma 2.2 unknown", "mixed", Optics(gamma=2.2, precorrected=False)),
)

UNKNOWN = Optics(gamma=2.2, precorrected=False, crosstalk_error=0.10)
HARD = (
    Case("standard", "mixed"),
    Case("rims", "rims"),
    Case("slots", "slots"),
    Case("bars", "bars"),
    Case("steep sides", "steep"),
    Case("hand before a face", "hand"),
    Case("gloss and dark parts", "gloss"),
    Case("beyond the volume", "beyond"),
    Case("over-exposed 1.8 times", "mixed", Optics(exposure=1.8)),
    Case("bright, over-exposed", "bright", Optics(exposure=1.8)),
    Case("projector in the middle", "mixed", layout=MIDDLE),
    Case("middle, modulated", "mixed", layout=MIDDLE, modulated=True),
    Case("middle, rims", "rims", layout=MIDDLE),
    Case("middle, modulated, white", "white", layout=MIDDLE, modulated=True),
    Case("middle, modulated, white bars", "white-bars", layout=MIDDLE, modulated=True),
    Case("middle, modulated, white balls", "balls", layout=MIDDLE, modulated=True),
    Case("Bayer", "mixed", encoding="bayer_rggb8"),
    Case("Bayer, realistic", "mixed", Optics.realistic(), encoding="bayer_rggb8"),
    Case("Bayer, unknown gamma and crosstalk", "mixed", UNKNOWN, encoding="bayer_rggb8"),
    Case("Bayer, slots", "slots", encoding="bayer_rggb8"),
    Case("Bayer, realistic, white slots", "white-slots", Optics.realistic(), encoding="bayer_rggb8"),
    Case("the demo's scene", "moving"),
    Case("plaster cast", "cast"),
    Case("plaster cast, Bayer", "cast", encoding="bayer_rggb8"),
    Case("plaster cast, realistic Bayer", "cast", Optics.realistic(), encoding="bayer_rggb8"),
    Case("plaster cast, wide fringes", "cast", layout=WIDE, periods=32.0),
    Case("wall that one camera sees, Bayer", "cast", Optics.realistic(), CLOSE, "bayer_rggb8", periods=73.0),
    Case("wall that one camera sees, far", "cast", Optics(noise=2.0, ambient=0.15), FAR, periods=84.0),
    Case("standard, wide fringes", "mixed", layout=WIDE, periods=32.0),
    Case("out of focus", "mixed", Optics(psf_px=1.3)),
    Case("strong colours", "colors"),
    Case("strong colours, Bayer", "colors", encoding="bayer_rggb8"),
    Case("print", "printed"),
    Case("print, Bayer", "printed", encoding="bayer_rggb8"),
    Case("print, middle", "printed", layout=MIDDLE),
)
"""Scenes and rigs in which wrong points and false surfaces arise; :mod:`benchmarks.trust` measures them."""


def random_case(number: int) -> Case:
    """The random scene of this number before a random rig with random faults."""
    rng = np.random.default_rng([11, number])
    fraction = rng.choice([0.382, 0.5, rng.uniform(0.25, 0.6)])
    baseline = rng.uniform(300, 600)
    layout = RigLayout(
        baseline_mm=baseline,
        projector_fraction=float(fraction),
        projector_up_mm=rng.uniform(0, 120),
        standoff_mm=1400.0,
        lens=rng.uniform(0, 1.5),
    )
    bayer = bool(rng.random() < 0.4)
    optics = random_optics(
        rng, realistic=0.4, noise=2.0, ambient=0.15, defocus_px=1.5, psf_px=0.8, crosstalk=0.12
    )  # fmt: skip
    return Case(
        f"random {number}",
        f"random-{number}",
        optics,
        layout,
        "bayer_rggb8" if bayer else "rgb8",
        modulated=bool(abs(fraction - 0.5) < 0.03 and rng.random() < 0.5),
        periods=float(rng.choice([64.0, 80.0, 96.0, 112.0])),
    )


def random_optics(
    rng: np.random.Generator, *, realistic: float, noise: float, ambient: float, defocus_px: float, psf_px: float,
    crosstalk: float,
) -> Optics:  # fmt: skip
    """Random faults of light and sensors.

    Args:
        realistic: probability of a rig that was calibrated with ordinary care only.
        noise, ambient, defocus_px, psf_px, crosstalk: the largest value of each.
    """
    faults = Optics.realistic() if rng.random() < realistic else Optics()
    return replace(
        faults,
        exposure=float(rng.choice([0.5, 1.0, 1.0, 1.4])),
        noise=rng.uniform(0.7, noise),
        ambient=rng.uniform(0.01, ambient),
        defocus_px=rng.uniform(0.5, defocus_px),
        psf_px=rng.uniform(0.4, psf_px),
        crosstalk=rng.uniform(0.02, crosstalk),
    )


def scaled(case: Case, scale: float) -> Case:
    """The case with fewer pixels and fringes."""
    if scale == 1.0:
        return case
    layout = case.layout.scaled(scale)
    return replace(case, layout=layout, periods=case.periods * scale)
