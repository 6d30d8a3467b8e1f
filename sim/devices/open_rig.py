"""A simulated rig behind the drivers' protocols, created from the ``sim`` options of a rig file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.protocols import Camera, Clock, MovesBoard, Projector, Side
from sim.devices.growing_loop import GrowingLoop
from sim.devices.live_world import LiveScene, LiveWorld
from sim.devices.options import SimOptions, from_mapping
from sim.devices.projector import LiveProjector, SimProjector
from sim.devices.rendered_loop import Progress, folder_of, loops_of, read
from sim.devices.scene_options import scene_of
from sim.devices.trigger_world import Images, SimWorld
from sim.render.render_pair import image_sent
from sim.rig import rig_files
from sim.scene.ray_hits import surfaces


@dataclass(frozen=True, slots=True, eq=False)
class RigDevices:
    """Devices and files of a simulated rig.

    Args:
        cameras: ``left`` and ``right``, closed.
        projector: closed.
        trigger: triggers by itself once a camera has started (``rate_hz`` above 0), else by ``step()``; ``close()``
            ends it and all devices. That of a live rig is a :class:`sim.devices.live_world.LiveWorld`.
        options: as checked.
        calibration, pattern, volume: plain mappings of the three files of such a rig.
        growing: the loop that is rendered in the background.
    """

    cameras: Mapping[Side, Camera]
    projector: Projector
    trigger: SimWorld
    options: SimOptions
    calibration: Mapping[str, Any]
    pattern: Mapping[str, Any]
    volume: Mapping[str, float]
    growing: GrowingLoop | None = None

    @property
    def board(self) -> MovesBoard | None:
        """Of a live rig."""
        return self.trigger if isinstance(self.trigger, LiveWorld) else None

    def close(self) -> None:
        """Stop the triggers and the rendering, and close all devices."""
        self.trigger.close()
        if self.growing is not None:
            self.growing.close()


def open_rig(
    options: Mapping[str, Any] | SimOptions,
    base_dir: Path | None = None,
    *,
    progress: Progress | None = None,
    clock: Clock | None = None,
    images: Images | None = None,
    first_number: int = 0,
    keep_entries: bool = False,
) -> RigDevices:
    """Create a simulated rig; renders its loop if it is not cached, or the first trigger of a live rig.

    The devices are created, not opened.

    Args:
        options: the ``sim`` section of a rig file, or checked options.
        base_dir: where relative paths in it start.
        progress: called with (done, of) while the loop is rendered.
        clock: the machine's if None.
        images: instead of the rendered loop.
        first_number: number of the first trigger.
        keep_entries: whether the ledger of faults keeps every event.
    """
    checked = options if isinstance(options, SimOptions) else from_mapping(options, base_dir)
    layout, optics = checked.layout, checked.optics
    shown = image_sent(layout.pattern(), optics, layout.projector_size)
    settings: dict[str, Any] = {
        "plan": checked.faults,
        "rate_hz": checked.rate_hz,
        "clock": clock,
        "first_number": first_number,
        "exposure_us": optics.exposure_us,
        "dark_dn": optics.black_dn,
        "keep_entries": keep_entries,
    }
    projector: SimProjector | LiveProjector
    world: SimWorld
    growing: GrowingLoop | None = None
    if checked.live and images is None:
        projector = LiveProjector(shown)
        scene = LiveScene(checked, projector)
        if progress is not None:
            progress(0, 1)
        scene.prepare(0)
        if progress is not None:
            progress(1, 1)
        world = LiveWorld(scene, projector, layout.camera_size, checked.encoding, **settings)
    else:
        projector = SimProjector(shown)
        if images is None and checked.background:
            growing = _growing(checked, progress)
        source = images if images is not None else growing or loops_of(checked, progress)
        world = SimWorld(source, projector, layout.camera_size, checked.encoding, **settings)
    return RigDevices(
        world.cameras,
        projector,
        world,
        checked,
        rig_files.calibration_mapping(layout, optics),
        rig_files.pattern_mapping(layout),
        rig_files.volume_mapping(layout),
        growing,
    )


def _growing(options: SimOptions, progress: Progress | None) -> GrowingLoop | None:
    """The loop rendered in the background; None where it is cached, or where there is no place for its files."""
    if read(folder_of(options)) is not None:
        return None
    if options.mesh is not None:  # what is wrong with it is reported here as for a loop that is rendered before
        surfaces(scene_of(options), 0.0, options.layout.stage_pose())
    try:
        return GrowingLoop(options, progress)
    except OSError:
        return None
