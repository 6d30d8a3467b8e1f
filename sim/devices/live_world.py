"""Camera images of the image that the projector shows, rendered on demand.

The light transport of a scene at rest is computed once (:class:`sim.render.projection_transport.Stage`); a new
projected image costs a look-up, another trigger under the same image only its noise.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from sim.devices.options import BOARD_SCENE, SimOptions
from sim.devices.projector import LiveProjector
from sim.devices.scene_options import optics_of, poses_of, scene_of
from sim.devices.trigger_world import Lamp, SimWorld
from sim.render.noise_pool import NoisePool, deviation_of
from sim.render.projection_transport import Stage
from sim.render.render_pair import Image
from sim.render.sensor import Light
from sim.rig.disturbance import Device, Disturbance, TrueRig

# Bytes of cached stages and of cached lit images.
_STAGE_BYTES, _LIT_BYTES = 600 << 20, 400 << 20
_BYTES_A_RAY = 20


@dataclass(frozen=True, slots=True)
class _Situation:
    """All that a stage depends on: pose of the board, instant of a moving scene, disturbances of the rig."""

    pose: int
    instant: int
    disturbances: tuple[Disturbance, ...]


class LiveScene:
    """Images of a scene under any projected image; for :class:`sim.devices.trigger_world.SimWorld`.

    Args:
        options: scene, rig, seed; ``disturb``: scheduled disturbances, ``hold``: triggers of each pose.
        projector: whose image is read at every trigger.
    """

    def __init__(self, options: SimOptions, projector: LiveProjector) -> None:
        self._options, self._projector, self._optics = options, projector, optics_of(options)
        self._poses = len(poses_of(options)) if options.scene == BOARD_SCENE else 1
        self._instants = options.frames if scene_of(options).moves else 1
        self._moved, self._disturbances = 0, options.disturb
        self._lock = threading.Lock()
        self._stages: OrderedDict[_Situation, Stage] = OrderedDict()
        self._lit: OrderedDict[tuple[_Situation, bytes], tuple[tuple[Light, Light], ...]] = OrderedDict()
        columns, rows = options.layout.camera_size
        channels = 3 if options.encoding == "rgb8" else 1
        self._values = columns * rows * channels
        self._pool = NoisePool(self._values, options.seed)
        rays = columns * rows * self._optics.supersampling**2
        self._stages_kept = max(2, self._instants, _STAGE_BYTES // (2 * _BYTES_A_RAY * rays))
        self._lit_kept = max(4, 2 * self._instants, _LIT_BYTES // (16 * self._values))

    @property
    def poses(self) -> int:
        """Poses of the board; 1 for every other scene."""
        return self._poses

    def pose(self, index: int) -> int:
        """Number of the pose at a trigger."""
        held = index // self._options.hold if self._options.hold else 0
        return min(self._moved + held, self._poses - 1)

    def next_pose(self, index: int) -> int:
        """Move the board to its next pose before trigger ``index``; returns its number. The last pose is kept."""
        with self._lock:
            self._moved += 1
            return self.pose(index)

    def disturb(self, disturbance: Disturbance) -> None:
        """Disturb the rig at the disturbance's trigger."""
        with self._lock:
            self._disturbances = (*self._disturbances, disturbance)

    def prepare(self, index: int) -> None:
        """Render the images of trigger ``index`` in advance."""
        self._counts(index)

    def pair(self, index: int) -> tuple[Image, Image]:
        """Left and right image of a trigger under the image that is shown now, each with its own noise."""
        left, right = (
            self._pool.image(counts, deviation, self._optics, self._options.encoding, index=2 * index + camera)
            for camera, (counts, deviation) in enumerate(self._counts(index))
        )
        return left, right

    def _situation(self, index: int) -> _Situation:
        with self._lock:
            disturbances = tuple(
                sorted((k for k in self._disturbances if k.at <= index), key=lambda disturbance: disturbance.at)
            )
            return _Situation(self.pose(index), index % self._instants, disturbances)

    def _counts(self, index: int) -> tuple[tuple[Light, Light], ...]:
        """(counts, deviation) of both cameras."""
        image, digest = self._projector.shown_at(index)
        situation = self._situation(index)
        key = situation, digest
        if key not in self._lit:
            counts = self._stage(situation).counts(image)
            self._lit[key] = tuple((part, deviation_of(part, self._optics)) for part in counts)
            while len(self._lit) > self._lit_kept:
                self._lit.popitem(last=False)
        self._lit.move_to_end(key)
        return self._lit[key]

    def _stage(self, situation: _Situation) -> Stage:
        if situation not in self._stages:
            scenes = situation.pose, situation.instant
            alike = (stage for known, stage in reversed(self._stages.items()) if (known.pose, known.instant) == scenes)
            like = next(alike, None)
            while len(self._stages) >= self._stages_kept:
                self._stages.popitem(last=False)
            options, optics = self._options, self._optics
            scene = scene_of(options, situation.pose)
            rig = TrueRig.of(options.layout, optics)
            for disturbance in situation.disturbances:
                rig = rig.after(disturbance)
            t_s = scene.period_s * situation.instant / self._instants
            self._stages[situation] = Stage(
                options.layout, scene, optics, encoding=options.encoding, instants_s=(t_s,), rig=rig, like=like
            )
        self._stages.move_to_end(situation)
        return self._stages[situation]


class LiveWorld(SimWorld):
    """A world whose images are rendered on demand, of the image that the projector shows.

    A trigger that cannot be rendered in time is delayed. Args as of :class:`SimWorld`, with a live scene.
    """

    _slack = 0.1

    def __init__(self, scene: LiveScene, projector: Lamp, size: tuple[int, int], encoding: str, **options: Any) -> None:
        note = "simulated: images are rendered of what the projector shows"
        super().__init__(scene, projector, size, encoding, note=note, **options)
        self._scene = scene

    @property
    def pose(self) -> int:
        """Number of the board's pose at the next trigger."""
        return self._scene.pose(self.triggers)

    @property
    def poses(self) -> int:
        """Number of the board's poses; 1 without a board."""
        return self._scene.poses

    def step(self) -> int:
        """Trigger once, when the images are ready; returns the trigger's number."""
        with self._lock:
            self._scene.prepare(self.triggers)
            return super().step()

    def next_pose(self) -> int:
        """Move the board to its next pose, effective at the next trigger.

        Returns:
            The number of the pose; the last one is kept.
        """
        return self._scene.next_pose(self.triggers)

    def disturb(self, side: Device, **change: Any) -> None:
        """Disturb a device from the next trigger on, in addition to earlier disturbances.

        Args:
            side: ``left``, ``right`` or ``projector``.
            change: ``turn_deg=(x, y, z)``, ``shift_px=(u, v)``, ``crosstalk=0.03``, see
                :class:`sim.rig.disturbance.Disturbance`.
        """
        self._scene.disturb(Disturbance(side, at=self.triggers, **change))
