"""The single shot against sets of images and against the truth: ``python -m benchmarks.accuracy.modes``, in simulation.

Scenes at rest are measured in every mode, by every kind of camera. Then a plane moves, towards the rig or sideways;
every image of a set is taken at its own time. Points of a mode must be right or unknown: the exit code is 1
when more than a hundredth of a set's points err by more than a millimetre.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.common.tables import Table
from pipeline.common.settings import Settings
from pipeline.multi_frame.set_reconstructor import SetReconstructor
from pipeline.pattern.mode_sequences import MODES, mode_sequence
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.evaluate.score import score
from sim.render.ground_truth import Truth
from sim.render.projection_transport import Stage
from sim.render.render_pair import truths
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from sim.scene.scene import Scene
from sim.scene.shapes import COLORED, Motion, Texture, plane

SINGLE = "single"
SCENES = "plane", "spheres", "steps", "mixed"
SPEEDS_M_S = 0.0, 0.01, 0.1, 0.3, 1.0
RATE_HZ = 100.0
ERROR_LIMIT_MM, SHARE_LIMIT = 1.0, 0.01
Images: TypeAlias = list[NDArray[Any]]
AnyReconstructor: TypeAlias = Reconstructor | SetReconstructor


@dataclass(frozen=True, slots=True)
class Rig:
    """The simulated rig, its optics, and the encoding of its cameras."""

    layout: RigLayout
    optics: Optics
    encoding: str = "rgb8"

    def modes(self) -> tuple[str, ...]:
        """Modes that these cameras can measure in."""
        return (SINGLE, *MODES) if not self.encoding.startswith("mono") else MODES[1:]

    def shown(self, mode: str) -> list[NDArray[np.uint8]]:
        """The projector's images of a mode."""
        if mode == SINGLE:
            return [self.layout.pattern().image()]
        sequence = mode_sequence(mode, self.layout.projector_size, periods=self.layout.periods)
        return [np.ascontiguousarray(frame.image()) for frame in sequence.frames]

    def reconstructor(self, mode: str) -> AnyReconstructor:
        """The reconstructor of a mode."""
        share = (self.layout.camera_size[0] / 1024) ** 2
        settings = Settings(cluster_min_area=max(20, round(120 * share)))
        calibration, volume = self.layout.calibration_for(self.optics), self.layout.volume()
        if mode == SINGLE:
            return Reconstructor(calibration, self.layout.pattern(), volume, encoding=self.encoding, settings=settings)
        sequence = mode_sequence(mode, self.layout.projector_size, periods=self.layout.periods)
        return SetReconstructor(calibration, sequence, volume, encoding=self.encoding, settings=settings)


def measured(reconstructor: AnyReconstructor, pairs: Sequence[tuple[NDArray[Any], NDArray[Any]]]) -> Cloud:
    """The cloud of a set, or of the one pair of the single shot."""
    if isinstance(reconstructor, Reconstructor):
        return reconstructor.reconstruct(*pairs[0])
    return reconstructor.reconstruct([left for left, _ in pairs], [right for _, right in pairs])


def at_rest(rig: Rig, scenes: Sequence[str]) -> Table:
    """Every mode on scenes that do not move."""
    headings = ["scene", "mode", "images", "within 1 mm %", "wrong %", "rms um", "5x5 rms um", "sigma um", "moved %"]
    table = Table("at_rest", f"Scenes at rest, {rig.encoding}", headings, text_columns=("mode",))
    reconstructors = {mode: rig.reconstructor(mode) for mode in rig.modes()}
    for name in scenes:
        scene = build(name)
        stage, truth = Stage(rig.layout, scene, rig.optics, encoding=rig.encoding), truths(rig.layout, scene)[0]
        for mode in rig.modes():
            shown = rig.shown(mode)
            pairs = [stage.images(stage.counts(image), 100 + k) for k, image in enumerate(shown)]
            cloud = measured(reconstructors[mode], pairs)
            found = score(cloud.xyz, truth)
            table.add(
                name, mode, f"{len(shown)}", f"{100 * found.reconstructed:.2f}", f"{100 * found.wrong:.3f}",
                f"{1e3 * found.rms_mm:.0f}", f"{1e3 * found.smooth_rms_mm:.1f}",
                f"{1e3 * float(np.nanmedian(cloud.sigma_mm)):.0f}", f"{_moved(cloud):.2f}",
            )  # fmt: skip
    table.notes.append("Within 1 mm: of the pixels that are lit and seen by both. Wrong: of the points, by over 6 mm.")
    return table


def in_motion(rig: Rig, direction: str) -> tuple[Table, list[tuple[str, bool]]]:
    """A plane at several speeds; every image of a set at its own time."""
    headings = ["m/s", "mode", "points %", "moved %", "median um", "95 % um", f"over {ERROR_LIMIT_MM:g} mm %"]
    table = Table(
        "in_motion", f"A plane moves {direction}, {RATE_HZ:g} images a second", headings, text_columns=("mode",)
    )
    reconstructors = {mode: rig.reconstructor(mode) for mode in rig.modes()}
    promises = []
    for speed in SPEEDS_M_S:
        scene = moving_plane(direction, speed)
        pairs = _captured(rig, scene)
        for mode in rig.modes():
            cloud = measured(reconstructors[mode], pairs[mode])
            maker = reconstructors[mode]
            centre = maker.plan.centre if isinstance(maker, SetReconstructor) else 0.0
            middle = centre / RATE_HZ + 0.5e-6 * rig.optics.exposure_us
            share, median, most, over = _errors(cloud, truths(rig.layout, scene, t_s=middle)[0])
            table.add(
                f"{speed:g}", mode, f"{share:.1f}", f"{_moved(cloud):.1f}", f"{median:.0f}", f"{most:.0f}",
                f"{over:.2f}",
            )  # fmt: skip
            kept = over <= 100 * SHARE_LIMIT or share < 100 * SHARE_LIMIT
            promises.append((f"{direction} at {speed:g} m/s, {mode}: right or unknown", kept))
    table.notes.append("Points: of the pixels that can be measured. Errors along the ray; moved: of the lit pixels.")
    return table, promises


def moving_plane(direction: str, speed: float) -> Scene:
    """A plane that passes z = 0 at time 0; away from the rig, or sideways with stains and speckles on it."""
    away = direction == "away"
    swing = (0.0, 0.0, 400.0) if away else (400.0, 0.0, 0.0)
    motion = Motion(swing_mm=swing) if speed else None
    texture = Texture() if away else COLORED
    shape = plane().placed((0, 0, 0), albedo=0.8, texture=texture, motion=motion)
    # A slow sine through its middle: 2 pi swing / period is the speed.
    return Scene("moving plane", (shape,), period_s=2 * pi * 400.0 / (1e3 * speed) if speed else 1.0)


def _captured(rig: Rig, scene: Scene) -> dict[str, list[tuple[NDArray[Any], NDArray[Any]]]]:
    """The pairs of every mode; image k of each is taken k periods of the triggers after the first."""
    shown = {mode: rig.shown(mode) for mode in rig.modes()}
    pairs: dict[str, Any] = {mode: [] for mode in shown}
    stage = None
    for k in range(max(len(images) for images in shown.values())):
        if stage is None or scene.moves:
            stage = Stage(rig.layout, scene, rig.optics, encoding=rig.encoding, instants_s=(k / RATE_HZ,))
        for mode, images in shown.items():
            if k < len(images):
                pairs[mode].append(stage.images(stage.counts(images[k]), 100 + k))
    return pairs


def _errors(cloud: Cloud, truth: Truth) -> tuple[float, float, float, float]:
    """Points in % of what can be measured; median and 95 % of the error, um; share over the limit, %."""
    valid = np.isfinite(cloud.xyz[..., 2]) & truth.hit
    share = 100 * float((valid & truth.scorable).sum() / max(1, truth.scorable.sum()))
    if valid.sum() < 20:
        return share, float("nan"), float("nan"), 0.0
    error = np.linalg.norm(cloud.xyz[valid] - truth.xyz[valid], axis=-1)
    median, most = np.quantile(error, [0.5, 0.95])
    return share, 1e3 * float(median), 1e3 * float(most), 100 * float((error > ERROR_LIMIT_MM).mean())


def _moved(cloud: Cloud) -> float:
    lit = int(np.count_nonzero(cloud.modulation[0] >= Settings().min_modulation))
    return 100 * cloud.moved / max(1, lit)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 1 when a promise is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.modes", description=__doc__)
    parser.add_argument("--scale", type=float, default=0.5, help="of all images; default: %(default)s")
    parser.add_argument("--only", choices=("rest", "motion"), help="one half of it")
    parser.add_argument("--markdown", action="store_true", help="tables as Markdown")
    chosen = parser.parse_args(arguments)
    rig = Rig(RigLayout().scaled(chosen.scale), Optics())
    console = Console()

    def show(table: Table) -> None:
        if chosen.markdown:
            sys.stdout.write(table.markdown() + "\n\n")
            sys.stdout.flush()
        else:
            table.print(console)

    if chosen.only != "motion":
        show(at_rest(rig, SCENES))
        for encoding in ("bayer_rggb8", "mono8"):
            show(at_rest(replace(rig, encoding=encoding), SCENES[3:]))
    broken = []
    for direction in ("away", "sideways") if chosen.only != "rest" else ():
        table, promises = in_motion(rig, direction)
        show(table)
        broken += [promise for promise, kept in promises if not kept]
    for promise in broken:
        sys.stdout.write(f"BROKEN: {promise}\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
