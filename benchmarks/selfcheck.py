"""How soon the self-check reports a disturbed rig, and how often it cries wolf: ``python -m benchmarks.selfcheck``.

A moving scene is rendered by the true rig and by rigs that were disturbed a little, and reconstructed with the
calibration of the true one. Every checked pair has a noise of its own.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.config.models import SelfCheckLimits
from daemon.selfcheck.watch import Watch, limits_of
from daemon.selfcheck.words import told
from pipeline.calibration import Calibration
from pipeline.camera_model import CameraModel
from pipeline.drift.observe import Observation, Observer, Reading
from pipeline.reconstruct import Reconstructor
from sim import render
from sim.optics import Optics
from sim.rig import RigLayout
from sim.scenes import build

RATE_HZ = 5.0
WITHIN_S = 5.0


@dataclass(frozen=True, slots=True)
class Knock:
    """What was done to a camera: turned about an axis of its own, its lens shifted, its crosstalk changed.

    Args:
        name: for the table; side: ``left``, ``right`` or none.
        turn_deg: about x (pitch), y (yaw), z (roll); shift_px: of the principal point.
        crosstalk: (camera, channel, of channel, by how much).
    """

    name: str
    side: str = ""
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_px: tuple[float, float] = (0.0, 0.0)
    crosstalk: tuple[int, int, int, float] | None = None


@dataclass(frozen=True, slots=True)
class KnockedLayout(RigLayout):
    """A rig that is not as its calibration says."""

    knock: Knock = Knock("none")

    def calibration(self) -> Calibration:
        """The rig as it really stands."""
        rig = RigLayout.calibration(self)
        if self.knock.side:
            device: CameraModel = getattr(rig, self.knock.side)
            turn, matrix = rotation(self.knock.turn_deg), device.matrix.copy()
            matrix[:2, 2] += self.knock.shift_px
            moved = CameraModel(
                device.size, matrix, device.distortion, turn @ device.rotation, turn @ device.translation, device.name
            )
            # A turned left camera is no world frame any more, which a calibration refuses and a renderer bears.
            object.__setattr__(rig, self.knock.side, moved)
        return rig


@dataclass(frozen=True)
class KnockedOptics(Optics):
    """Cameras whose colours are not as their calibration says."""

    knock: Knock = Knock("none")

    def true_crosstalk(self) -> NDArray[np.float64]:
        """Crosstalk as it really is."""
        out = Optics.true_crosstalk(self)
        if self.knock.crosstalk is not None:
            camera, c, p, by = self.knock.crosstalk
            out[camera, c, p] += by
        return out

    def gain(self, camera: int) -> float:
        """The exposure stays as it was."""
        return Optics(**{f.name: getattr(self, f.name) for f in fields(Optics)}).gain(camera)


def rotation(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    """Rotation by a small rotation vector."""
    x, y, z = np.deg2rad(degrees)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = float(np.sqrt(x * x + y * y + z * z))
    if angle == 0:
        return np.eye(3)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross)


def knocks() -> list[Knock]:
    """Everything that must be reported."""
    out = []
    for side in ("left", "right"):
        for k, axis in enumerate(("pitch", "yaw", "roll")):
            turn = tuple(0.01 if i == k else 0.0 for i in range(3))
            out.append(Knock(f"{side} camera, {axis} 0.01 deg", side, turn_deg=turn))  # type: ignore[arg-type]
        for k, axis in enumerate("uv"):
            shift = (0.2, 0.0) if k == 0 else (0.0, 0.2)
            out.append(Knock(f"{side} lens, {axis} 0.2 px", side, shift_px=shift))
    names = "red", "green", "blue"
    for camera, side in enumerate(("left", "right")):
        for c, p in ((0, 1), (1, 0), (1, 2), (2, 1), (2, 0), (0, 2)):
            out.append(Knock(f"{side} crosstalk {names[p]} in {names[c]} +0.03", crosstalk=(camera, c, p, 0.03)))
    return out


class Rig:
    """Pairs of a scene and what the self-check reads from them.

    Args:
        scale: of the standard rig; scene: name; encoding: of the cameras.
    """

    def __init__(self, scale: float, *, scene: str = "moving", encoding: str = "rgb8", patches: int = 150) -> None:
        base = RigLayout() if scale == 1 else RigLayout().scaled(scale)
        self.layout = KnockedLayout(**{f.name: getattr(base, f.name) for f in fields(RigLayout)})
        self.optics, self.scene, self.encoding = KnockedOptics(), build(scene), encoding
        calibration, pattern = base.calibration_for(self.optics), base.pattern()
        self.reconstructor = Reconstructor(calibration, pattern, base.volume(), encoding=encoding)
        self.observer = Observer(calibration, pattern, base.volume(), encoding=encoding, patches=patches)
        self.ms: list[float] = []

    def counts(self, knock: Knock, frames: int) -> list[Any]:
        """Noiseless pictures over one period of the scene."""
        layout, optics = replace(self.layout, knock=knock), replace(self.optics, knock=knock)
        times = [self.scene.period_s * i / frames for i in range(frames)]
        pattern = self.layout.pattern()
        return [render.render_counts(layout, self.scene, pattern, optics, t, self.encoding) for t in times]

    def look(self, counts: list[Any], seed: int) -> Iterator[Observation]:
        """One pair after the other, round and round, each with fresh noise."""
        index = 0
        while True:
            pictures = render.with_noise(counts[index % len(counts)], self.optics, seed + index, self.encoding)
            cloud = self.reconstructor.reconstruct(*pictures)
            began = time.perf_counter()
            seen = self.observer.observe(*pictures, cloud)
            self.ms.append(1e3 * (time.perf_counter() - began))
            yield seen
            index += 1


def feed(watch: Watch, number: int, seen: Observation) -> None:
    """As the daemon does."""
    watch.feed(number / RATE_HZ, seen.readings, surface=Reading(seen.known, 0.01))


def undisturbed(rig: Rig, counts: list[Any], pairs: int) -> tuple[Watch, int, dict[str, NDArray[np.float64]]]:
    """The watch after ``pairs`` pairs, how many reports there were, and every reading."""
    watch = Watch(limits_of(SelfCheckLimits()), {})
    alarms, kept = 0, []
    for number, seen in enumerate(islice(rig.look(counts, 1_000_000), pairs)):
        before = set(watch.drifted)
        feed(watch, number, seen)
        alarms += len(set(watch.drifted) - before)
        kept.append(seen.readings)
    names = sorted({name for readings in kept for name in readings})
    none = Reading(np.nan, np.nan)
    return watch, alarms, {name: np.array([r.get(name, none).value for r in kept]) for name in names}


def disturbed(rig: Rig, before: list[Any], after: list[Any], watch: Watch) -> tuple[float | None, Watch]:
    """Seconds from the knock to the report (None: not within the time), and the watch then."""
    fresh = Watch(limits_of(SelfCheckLimits()), watch.references)
    for number, seen in enumerate(islice(rig.look(before, 5_000_000), 12)):
        feed(fresh, number, seen)
    if fresh.drifted:
        raise RuntimeError(f"reported before anything happened: {fresh.drifted}")
    for number, seen in enumerate(islice(rig.look(after, 7_000_000), round(RATE_HZ * WITHIN_S))):
        feed(fresh, 12 + number, seen)
        if fresh.drifted:
            return (number + 1) / RATE_HZ, fresh
    return None, fresh


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=0.5, help="of the standard rig, 1 = 1024 x 820 pixels")
    parser.add_argument("--pairs", type=int, default=10_000, help="undisturbed pairs")
    parser.add_argument("--scene", default="moving")
    parser.add_argument("--encoding", default="rgb8")
    parser.add_argument("--loop", type=int, default=12, help="rendered positions of the scene")
    parser.add_argument("--only", default="", help="knocks whose name holds this")
    options = parser.parse_args()
    rig = Rig(options.scale, scene=options.scene, encoding=options.encoding)
    still = rig.counts(Knock("none"), options.loop)
    watch, alarms, readings = undisturbed(rig, still, options.pairs)
    print(f"{options.scene}, scale {options.scale}, {options.encoding}; {rig.optics.knock.name} disturbed")
    print(f"undisturbed: {options.pairs} pairs, {alarms} reports; {np.median(rig.ms):.1f} ms a check (median)")
    print(f"{'observable':22} {'median':>9} {'scatter':>9} {'limit':>9}")
    for name, values in readings.items():
        limit = watch.found[name].limit
        print(f"{name:22} {np.nanmedian(values):+9.4f} {np.nanstd(values):9.4f} {limit:9.4f}")
    missed = 0
    for knock in knocks():
        if options.only not in knock.name:
            continue
        after, found = disturbed(rig, still, rig.counts(knock, 3), watch)
        missed += after is None
        when = "NOT REPORTED" if after is None else f"{after:4.1f} s"
        print(f"{knock.name:38} {when}  {told(found.drifted)}", flush=True)
    print(f"{missed} missed, {alarms} false reports")


if __name__ == "__main__":
    main()
