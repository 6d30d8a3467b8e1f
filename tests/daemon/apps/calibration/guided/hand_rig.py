"""A lit rig with a board in a simulated hand; its images contain numbers instead of marks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.common.errors import TargetError
from sim.devices.open_rig import RigDevices
from sim.devices.trigger_world import SimWorld
from tests.daemon.apps.calibration.guided.test_session_state import detection
from tests.daemon.lit_rig import FreeProjector, devices
from tests.pipeline.calibrate.bundle.sessions import session as made_session

VIEWS, SIZES, _ = made_session(n=16, devices=("left", "right"), seed=3)
BOARD = DEFAULT_BOARD
DARK = 40
"""Marks are not detected in less light."""


class Hand:
    """Moves the board to its next pose."""

    def __init__(self, world: SimWorld) -> None:
        self.pose, self.moves = 0, 0
        self._world = world

    def next_pose(self) -> int:
        self.pose = (self.pose + 1) % len(VIEWS)
        self.moves += 1
        return self.pose

    def close(self) -> None:
        self._world.close()


class HandImages:
    """Light, side and pose in the first pixels of images of the true size."""

    def __init__(self, projector: FreeProjector) -> None:
        self.projector, self.hand = projector, None

    def pair(self, index: int) -> tuple[Any, Any]:  # noqa: ARG002 - the protocol's
        images = []
        for side in (0, 1):
            width, height = SIZES[("left", "right")[side]]
            image = np.full((height // 8, width // 8, 3), min(self.projector.level, 250), np.uint8)
            image[0, 0] = (self.hand.pose, side, 77)  # type: ignore[attr-defined]
            image.setflags(write=False)
            images.append(image)
        return images[0], images[1]


@dataclass
class HandDevices:
    cameras: Any
    projector: FreeProjector
    board: Hand
    plain: RigDevices

    def close(self) -> None:
        self.board.close()


def hand_devices(rate_hz: float = 200.0) -> HandDevices:
    plain, projector, _ = devices(rate_hz)
    images = HandImages(projector)
    width, height = SIZES["left"]
    world = SimWorld(images, projector, (width // 8, height // 8), "rgb8", rate_hz=rate_hz, exposure_us=500.0)  # type: ignore[arg-type]
    hand = Hand(world)
    images.hand = hand  # type: ignore[assignment]
    return HandDevices(world.cameras, projector, hand, plain)


def find(image: Any, board: Board) -> Detection:
    """Return the marks that the numbers encode."""
    assert board == BOARD
    if image[1, 1].max() < DARK:
        raise TargetError("too dark")
    pose, side, check = (int(value) for value in image[0, 0])
    assert check == 77
    return detection(VIEWS[pose].marks[("left", "right")[side]])


def open_rig(options: dict[str, Any], base_dir: Any, *, progress: Any = None) -> HandDevices:  # noqa: ARG001
    """Entry of the driver table."""
    return hand_devices()
