"""Delay of the self-check's reports and rate of its false alarms: ``python -m benchmarks.calibration.selfcheck``.

A moving scene is rendered by the true rig and by rigs that were disturbed a little, and reconstructed with the
calibration of the true one. Every checked pair has a noise of its own.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from daemon.config.rig_config import SelfCheckLimits
from daemon.monitoring.calibration_drift.explanation import describe
from daemon.monitoring.calibration_drift.verdicts import Assessor, limits_of
from pipeline.monitor.observe import Observation, Observer, Reading
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.devices.live_world import LiveScene
from sim.devices.options import SimOptions
from sim.devices.projector import LiveProjector
from sim.render.render_pair import image_sent
from sim.rig.disturbance import Disturbance
from sim.rig.layout import RigLayout

RATE_HZ = 5.0
WITHIN_S = 5.0
BEFORE = 12  # undisturbed pairs before each disturbance

DISTURBANCES: dict[str, Disturbance] = {
    **{
        f"{side} camera, {axis} 0.01 deg": Disturbance(
            side, turn_deg=(0.01 * (k == 0), 0.01 * (k == 1), 0.01 * (k == 2))
        )
        for side in ("left", "right")
        for k, axis in enumerate(("pitch", "yaw", "roll"))
    },
    **{
        f"{side} lens, {axis} 0.2 px": Disturbance(side, shift_px=(0.2 * (k == 0), 0.2 * (k == 1)))
        for side in ("left", "right")
        for k, axis in enumerate("uv")
    },
    **{f"{side} crosstalk +0.03": Disturbance(side, crosstalk=0.03) for side in ("left", "right")},
    **{f"{side} crosstalk -0.03": Disturbance(side, crosstalk=-0.03) for side in ("left", "right")},
}
"""Everything that must be reported."""


class Rig:
    """Pairs of a scene, and the self-check's readings from them.

    Args:
        scale: of the standard rig; scene: name; encoding: of the cameras; instants: of a moving scene.
    """

    def __init__(
        self, scale: float, *, scene: str = "moving", encoding: str = "rgb8", patches: int = 150, instants: int = 12
    ) -> None:
        layout = RigLayout() if scale == 1 else RigLayout().scaled(scale)
        self.options = SimOptions(scene=scene, layout=layout, encoding=encoding, live=True, frames=instants)
        self.calibration = layout.calibration_for(self.options.optics)
        self.pattern, self.volume = layout.pattern(), layout.volume()
        self.reconstructor = Reconstructor(self.calibration, self.pattern, self.volume, encoding=encoding)
        self.observer = Observer(self.calibration, self.pattern, self.volume, encoding=encoding, patches=patches)
        self.ms: list[float] = []

    def scene(self, *disturbances: Disturbance) -> LiveScene:
        """The scene of the rig after these disturbances."""
        shown = image_sent(self.pattern, self.options.optics, self.pattern.size)
        live_scene = LiveScene(self.options, LiveProjector(shown))
        for disturbance in disturbances:
            live_scene.disturb(disturbance)
        return live_scene

    def observations(self, scene: LiveScene, first: int = 0) -> Iterator[Observation]:
        """One pair after the other, the scene moving on, each with fresh noise."""
        for index in range(first, 1 << 30):
            images = scene.pair(index)
            cloud = self.reconstructor.reconstruct(*images)
            started = time.perf_counter()
            observation = self.observer.observe(*images, cloud)
            self.ms.append(1e3 * (time.perf_counter() - started))
            yield observation


def feed(assessor: Assessor, number: int, observation: Observation) -> None:
    """Feed the assessor as the daemon does."""
    assessor.feed(number / RATE_HZ, observation.readings, surface=Reading(observation.valid, 0.01))


def undisturbed(
    rig: Rig, scene: LiveScene, pairs: int, first: int = 0
) -> tuple[Assessor, int, dict[str, NDArray[np.float64]]]:
    """The assessor after ``pairs`` pairs, how many reports there were, and every reading."""
    assessor = Assessor(limits_of(SelfCheckLimits()), {})
    alarms, kept = 0, []
    for number, observation in enumerate(islice(rig.observations(scene, first), pairs)):
        before = set(assessor.drifted)
        feed(assessor, number, observation)
        alarms += len(set(assessor.drifted) - before)
        kept.append(observation.readings)
        if (number + 1) % 500 == 0:
            print(f"{number + 1} undisturbed pairs, {alarms} reports", flush=True)
    names = sorted({name for readings in kept for name in readings})
    none = Reading(np.nan, np.nan)
    return assessor, alarms, {name: np.array([r.get(name, none).value for r in kept]) for name in names}


def disturbed(
    rig: Rig, scene: LiveScene, disturbance: Disturbance, assessor: Assessor
) -> tuple[float | None, Assessor]:
    """Seconds from the disturbance to the report (None: not within the time), and the assessor then."""
    fresh = Assessor(limits_of(SelfCheckLimits()), assessor.references)
    for number, observation in enumerate(islice(rig.observations(scene, 1 << 20), BEFORE)):
        feed(fresh, number, observation)
    if fresh.drifted:
        raise RuntimeError(f"reported before anything happened: {fresh.drifted}")
    after = rig.observations(rig.scene(disturbance), BEFORE)
    for number, observation in enumerate(islice(after, round(RATE_HZ * WITHIN_S))):
        feed(fresh, BEFORE + number, observation)
        if fresh.drifted:
            return (number + 1) / RATE_HZ, fresh
    return None, fresh


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=0.5, help="of the standard rig, 1 = 1024 x 820 pixels")
    parser.add_argument("--pairs", type=int, default=10_000, help="undisturbed pairs, all of them checked")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them: another noise")
    parser.add_argument("--scene", default="moving")
    parser.add_argument("--encoding", default="rgb8")
    parser.add_argument("--instants", type=int, default=12, help="rendered positions of the scene")
    parser.add_argument("--only", default="", help="disturbances whose name holds this")
    options = parser.parse_args()
    rig = Rig(options.scale, scene=options.scene, encoding=options.encoding, instants=options.instants)
    still = rig.scene()
    assessor, alarms, readings = undisturbed(rig, still, options.pairs, options.first)
    print(f"{options.scene}, scale {options.scale}, {options.encoding}")
    print(f"undisturbed: {options.pairs} pairs, {alarms} reports; {np.median(rig.ms):.1f} ms a check (median)")
    print(f"{'observable':22} {'median':>9} {'scatter':>9} {'limit':>9}")
    for name, values in readings.items():
        limit = assessor.assessments[name].limit
        print(f"{name:22} {np.nanmedian(values):+9.4f} {np.nanstd(values):9.4f} {limit:9.4f}")
    missed = 0
    for name, disturbance in DISTURBANCES.items():
        if options.only not in name:
            continue
        after, found = disturbed(rig, still, disturbance, assessor)
        missed += after is None
        when = "NOT REPORTED" if after is None else f"{after:4.1f} s"
        print(f"{name:28} {when}  {describe(found.drifted)}", flush=True)
    print(f"{missed} missed, {alarms} false reports")


if __name__ == "__main__":
    main()
