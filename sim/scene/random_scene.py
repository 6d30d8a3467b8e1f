"""Random scenes: backgrounds, objects, textures and gloss are drawn from a seed.

They show whether limits that were set on the named scenes hold on other scenes. Stage coordinates as in
:mod:`sim.scene.named_scenes`.
"""

from __future__ import annotations

import numpy as np

from sim.scene.scene import Scene
from sim.scene.shapes import Shape, Texture, Triple, box, cylinder, rectangle, relief, sphere

_X_MM, _Y_MM, _Z_MM = 190.0, 150.0, (-80.0, 70.0)
_OBJECTS = (5, 12)
_GLOSSY = 0.15
_BARS = (4, 9)


def random_scene(seed: int) -> Scene:
    """The scene of a seed: perhaps a background, 5 to 11 objects, perhaps a row of bars."""
    rng = np.random.default_rng([7, seed])
    shapes = _background(rng)
    shapes += [_object(rng) for _ in range(rng.integers(*_OBJECTS))]
    if rng.random() < 0.4:
        shapes += _row_of_bars(rng)
    return Scene(f"random {seed}", tuple(shapes))


def _background(rng: np.random.Generator) -> list[Shape]:
    kind = rng.random()
    if kind < 0.25:
        return []
    size = (430.0, 330.0) if kind < 0.6 else (1200.0, 900.0)
    depth = rng.uniform(50, 80) if kind < 0.85 else rng.uniform(150, 500)
    turn = (rng.normal(0, 0.05), rng.normal(0, 0.08), 0.0)
    return [rectangle(*size).placed((0, 0, depth), turn=turn, albedo=_albedo(rng), texture=_texture(rng))]


def _object(rng: np.random.Generator) -> Shape:
    size = float(np.exp(rng.uniform(np.log(8), np.log(60))))
    a, b = (float(size * rng.uniform(0.4, 2.0)) for _ in range(2))
    turn: Triple = (rng.normal(0, 0.4), rng.normal(0, 0.5), rng.normal(0, 0.8))
    kind = rng.choice(["sphere", "box", "cylinder", "rectangle", "face", "waves"])
    if kind == "sphere":
        shape = sphere(size)
    elif kind == "box":
        shape = box(1.6 * size, 1.6 * a, 1.6 * b)
    elif kind == "cylinder":
        shape = cylinder(0.5 * size, 2 * a)
    elif kind == "rectangle":
        shape = rectangle(2 * a, 2 * b)
    else:
        shape = relief(2 * a, 2 * b, 0.7 * size, variant=str(kind))
    gloss = (rng.uniform(0.3, 1.0), float(np.exp(rng.uniform(3.0, 5.7)))) if rng.random() < _GLOSSY else (0.0, 1.0)
    return shape.placed(_place(rng), turn=turn, albedo=_albedo(rng), texture=_texture(rng), gloss=gloss)


def _row_of_bars(rng: np.random.Generator) -> list[Shape]:
    x, y, z = _place(rng)
    width, gap, length = rng.uniform(2, 8), rng.uniform(3, 9), rng.uniform(40, 120)
    turn, albedo, texture = rng.uniform(0, np.pi), _albedo(rng), _texture(rng)
    step = (width + gap) * np.array([np.cos(turn), np.sin(turn)])
    return [
        rectangle(width, length).placed(
            (float(x + k * step[0]), float(y + k * step[1]), z), turn=(0.0, 0.0, turn), albedo=albedo, texture=texture
        )
        for k in range(rng.integers(*_BARS))
    ]


def _place(rng: np.random.Generator) -> Triple:
    return (rng.uniform(-_X_MM, _X_MM), rng.uniform(-_Y_MM, _Y_MM), rng.uniform(*_Z_MM))


def _albedo(rng: np.random.Generator) -> Triple:
    gray = rng.uniform(0.08, 0.95) if rng.random() < 0.3 else rng.uniform(0.45, 0.85)
    color = np.clip(gray * (1 + rng.uniform(0, 0.25) * rng.uniform(-1, 1, 3)), 0.03, 1.0)
    return (float(color[0]), float(color[1]), float(color[2]))


def _texture(rng: np.random.Generator) -> Texture:
    if rng.random() < 0.3:
        return Texture()
    return Texture(
        smooth=rng.uniform(0.05, 0.45), smooth_mm=rng.uniform(8, 50), speckle=rng.uniform(0, 0.15),
        speckle_mm=rng.uniform(1.5, 5),
    )  # fmt: skip
