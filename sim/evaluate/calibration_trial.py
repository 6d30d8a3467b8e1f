"""Trial of a calibration: measurements of the simulated rig with it, against the truth.

The projected fringe is corrected by the response of the *calibration*, as the daemon would do; the cameras' images
follow from the true rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from sim.evaluate.score import AlignedScore, aligned
from sim.render import render_pair
from sim.render.ground_truth import Truth
from sim.render.render_pair import Image
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build

SCENES = ("plane", "spheres", "face")


def true_calibration(layout: RigLayout, optics: Optics) -> Calibration:
    """The calibration of a rig without any error."""
    return layout.calibration_for(replace(optics, crosstalk_error=0.0, projector_error_px=(0.0, 0.0)))


def measuring_pair(
    calibration: Calibration,
    layout: RigLayout,
    scene: str,
    optics: Optics | None = None,
    *,
    pattern: ColorFringe | None = None,
    encoding: str = "rgb8",
    seed: int = 0,
) -> tuple[Image, Image, Truth]:
    """Both images of a scene under the fringe as shown with this calibration, and the left truth.

    Args:
        calibration: only its response is used. layout, optics: the rig as it is.
        scene: name, see :mod:`sim.scene.named_scenes`. pattern: that of the layout if None. seed: of textures and
            noise.
    """
    optics, pattern = optics or Optics(), pattern or layout.pattern()
    built = build(scene, seed=seed)
    left, right = render_pair.render_images(
        layout, built, pattern.image(calibration.response), optics, seed=seed, encoding=encoding
    )
    truth, _ = render_pair.truths(layout, built, pattern, 0.5e-6 * optics.exposure_us)
    return left, right, truth


def trial_scores(
    calibration: Calibration,
    layout: RigLayout,
    optics: Optics | None = None,
    *,
    scenes: Sequence[str] = SCENES,
    pattern: ColorFringe | None = None,
    encoding: str = "rgb8",
    seed: int = 0,
) -> dict[str, AlignedScore]:
    """Score of each scene measured with a calibration, after the best rigid motion of each cloud.

    Args: as of :func:`measuring_pair`, with the names of several scenes.
    """
    pattern = pattern or layout.pattern()
    reconstructor = Reconstructor(calibration, pattern, layout.volume(), encoding=encoding)
    found = {}
    for name in scenes:
        left, right, truth = measuring_pair(
            calibration, layout, name, optics, pattern=pattern, encoding=encoding, seed=seed
        )
        found[name] = aligned(reconstructor.reconstruct(left, right).xyz, truth)
    return found
