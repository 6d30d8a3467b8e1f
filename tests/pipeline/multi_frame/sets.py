"""Small rendered sets: a quarter of the standard rig each way, every image with a noise of its own."""

import functools
from math import pi

import numpy as np

from pipeline.common.settings import Settings
from pipeline.multi_frame.set_reconstructor import SetReconstructor
from pipeline.pattern.mode_sequences import mode_sequence
from sim.render.projection_transport import Stage
from sim.render.render_pair import truths
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from sim.scene.scene import Scene
from sim.scene.shapes import Motion, plane
from tests.renders import stored

LAYOUT, OPTICS = RigLayout().scaled(0.25), Optics()
SETTINGS = Settings(cluster_min_area=20)
RATE_HZ = 100.0


def sequence(mode, **options):
    return mode_sequence(mode, LAYOUT.projector_size, periods=LAYOUT.periods, **options)


def made(mode, encoding="rgb8", optics=OPTICS, **options):
    """What measures in a mode; the small rig's surfaces are small."""
    options = {"settings": SETTINGS} | options
    return SetReconstructor(
        LAYOUT.calibration_for(optics), sequence(mode), LAYOUT.volume(), encoding=encoding, **options
    )


@functools.cache
def taken(mode, encoding="rgb8", scene="mixed", optics=OPTICS):
    """Left and right images of a scene at rest."""
    return stored(_at_rest, mode, encoding, scene, optics)


def _at_rest(mode, encoding, scene, optics):
    stage = Stage(LAYOUT, build(scene), optics, encoding=encoding)
    response = LAYOUT.calibration_for(optics).response if optics.precorrected else None
    return _sides(
        stage.images(stage.counts(np.ascontiguousarray(frame.image(response))), 10 + k)
        for k, frame in enumerate(sequence(mode).frames)
    )


@functools.cache
def truth(scene="mixed"):
    return stored(truths, LAYOUT, build(scene))[0]


@functools.cache
def in_motion(mode, speed_m_s):
    """Left and right images of a plane that moves away from the rig, each taken at its own time."""
    return stored(_moving_plane, mode, speed_m_s)


def _moving_plane(mode, speed_m_s):
    motion = Motion(swing_mm=(0.0, 0.0, 400.0))
    shape = plane().placed((0, 0, 0), albedo=0.8, motion=motion)
    scene = Scene("moving plane", (shape,), period_s=2 * pi * 0.4 / speed_m_s)
    pairs = []
    for k, frame in enumerate(sequence(mode).frames):
        stage = Stage(LAYOUT, scene, OPTICS, instants_s=(k / RATE_HZ,))
        pairs.append(stage.images(stage.counts(np.ascontiguousarray(frame.image())), 10 + k))
    return _sides(pairs)


def _sides(pairs):
    lefts, rights = zip(*pairs, strict=True)
    return list(lefts), list(rights)
