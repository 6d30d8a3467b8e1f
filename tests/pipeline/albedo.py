"""Truth of colours: the light that every pixel of the left camera gets without fringes."""

import functools
from dataclasses import replace

import numpy as np

from sim.render.render_pair import light_on_sensor
from sim.rig.disturbance import TrueRig
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from sim.scene.shapes import Texture
from tests.pipeline.small import LAYOUT

WHITE = 0.98


@functools.cache
def unfringed(name, white=False):
    """Counts above black of an even light of the fringe's mean, without crosstalk, (H, W, 3).

    ``white``: all shapes have the albedo WHITE instead of their colours.
    """
    optics, scene = Optics(), build(name)
    if white:
        shapes = tuple(replace(shape, albedo=(WHITE,) * 3, texture=Texture()) for shape in scene.shapes)
        scene = replace(scene, shapes=shapes)
    rig = TrueRig.of(LAYOUT, optics)
    light = np.full((*rig.projector.size[::-1], 3), 127.5, np.float32)
    return optics.gain(0) * light_on_sensor(LAYOUT, rig.projector, scene, light, optics, 0.0, rig.left)


def albedo_errors(name, rgb):
    """Absolute errors of the albedo, 0 .. 1, that a measured colour (H, W, 3) gives with the known light; the truth."""
    shading = np.maximum(unfringed(name, white=True), 1) / WHITE
    truth = unfringed(name) / shading
    return np.abs(rgb / shading - truth), truth
