"""Every frame that the GenICam driver delivers is what the projector showed at its trigger, byte by byte."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import yaml

from daemon.live.acquisition.pairer import Pairer
from daemon.live.acquisition.pairing_events import Lost, PairingSettings
from daemon.live.items import Pair
from drivers.genicam import open_camera
from drivers.projector import OutputProjector, open_projector
from drivers.protocols import SIDES, Camera, Side
from sim.box.box import Box
from sim.render.projection_transport import Stage
from sim.scene import named_scenes

TRIGGERS = 60


@contextmanager
def devices(box: Box) -> Iterator[tuple[OutputProjector, dict[Side, Camera]]]:
    """The projector and both cameras of the box's rig file, open and waiting for triggers."""
    rig = yaml.safe_load(box.rig_file.read_text())
    projector = open_projector(rig["projector"]["options"], box.folder)
    cameras: dict[Side, Camera] = {side: open_camera(side, rig["cameras"][side], box.folder) for side in SIDES}
    try:
        projector.open()
        for side in SIDES:
            cameras[side].open()
            cameras[side].start()
        for side in SIDES:
            assert box.cables[side].wait_armed(30)
        yield projector, cameras
    finally:
        for camera in cameras.values():
            camera.close()
        projector.close()


def images(box: Box) -> list[np.ndarray]:
    """White, the fringes, and noise that no scene and no fringe resembles."""
    width, height = box.options.layout.projector_size
    noise = np.random.default_rng(8).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return [np.full_like(noise, 255), box.options.layout.pattern().image(), noise]


@pytest.mark.slow
@pytest.mark.parametrize("encoding", [pytest.param("rgb8", marks=pytest.mark.long), "bayer_rggb8"])
def test_frames_are_what_was_shown_and_pairs_are_right(make_box: Callable[..., Box], encoding: str) -> None:
    box = make_box(encoding=encoding)
    optics, layout = box.options.simulation.optics, box.options.layout
    moving = Stage(layout, named_scenes.build("moving"), optics, encoding=encoding, instants_s=(0.0, 0.8, 1.7))
    shown_images, pairer, counts = images(box), Pairer(PairingSettings(tolerance_ns=500_000)), Counter[str]()
    with devices(box) as (projector, cameras):
        for index in range(TRIGGERS):
            if index % 10 == 0:
                projector.show(shown_images[index // 10 % len(shown_images)])
                assert projector.problem() == ""
            if index == TRIGGERS // 2:
                box.world.set_stage(moving, instants=3)
            shown = box.world.step()
            assert not shown.dark
            counts[shown.image.hex()] += 1
            for side in SIDES:
                frame = cameras[side].read(10.0)
                assert frame is not None and frame.encoding == encoding
                assert box.world.ledger.exposure_of(side, frame.image) == shown
                assert frame.t_device_ns == box.cables[side].device_ns(shown.t_ns)
                for event in pairer.feed(frame):
                    assert not isinstance(event, Lost)
                    if isinstance(event, Pair):
                        seen = {s: box.world.ledger.exposure_of(s, getattr(event, s).image) for s in SIDES}
                        assert seen["left"] == seen["right"] is not None
                        counts["pairs"] += 1
        assert all(cameras[side].read(0.01) is None for side in SIDES)
    assert counts.pop("pairs") == TRIGGERS
    assert sorted(counts.values()) == [TRIGGERS / 3] * 3
    states = [box.cables[side].state() for side in SIDES]
    assert [state.delivered for state in states] == [TRIGGERS] * 2
    assert not any(state.missed or state.dropped or state.no_buffer for state in states)
