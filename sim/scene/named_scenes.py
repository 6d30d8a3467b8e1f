"""Scenes by name, in stage coordinates (x right, y down, z away from the rig; millimetres).

They fill the standard field of about 420 x 335 mm and stay inside its volume of 230 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from sim.scene import hard_scenes
from sim.scene.random_scene import random_scene
from sim.scene.scene import SKIN, Scene, board
from sim.scene.shapes import COLORED, Motion, Shape, Texture, box, cylinder, mesh, plane, rectangle, relief, sphere


def build(name: str, *, seed: int = 0, mesh_file: Path | None = None) -> Scene:
    """The scene of a name; ``seed`` changes the textures, ``mesh_file`` is for the scene ``mesh``.

    ``random-`` and a number is the scene of :func:`sim.scene.random_scene.random_scene`.
    """
    if name == "mesh":
        if mesh_file is None:
            raise ValueError("scene 'mesh' needs a file of a triangle mesh (OBJ, PLY or STL): set sim.mesh")
        return Scene("mesh", (mesh(Path(mesh_file), 90.0).placed(albedo=0.75), board(0.6)))
    number = name.removeprefix("random-")
    if number != name and number.isdecimal():
        return _varied(random_scene(int(number)), seed)
    if name not in _SCENES:
        raise ValueError(f"scene {name!r} is not known; there are {', '.join(NAMES)}")
    return _varied(_SCENES[name](), seed)


def _varied(scene: Scene, seed: int) -> Scene:
    return replace(scene, shapes=tuple(_with_seed(shape, i, seed) for i, shape in enumerate(scene.shapes)))


def _with_seed(shape: Shape, index: int, seed: int) -> Shape:
    return replace(shape, texture=replace(shape.texture, seed=7919 * seed + 31 * index))


def _plane() -> Scene:
    return Scene("plane", (plane().placed(albedo=0.9),))


def _spheres() -> Scene:
    return Scene(
        "spheres",
        (
            board(0.85),
            sphere(48).placed((-95, -40, 15), albedo=0.8),
            sphere(30).placed((15, 60, 5), albedo=0.8),
            sphere(60).placed((115, -25, 0), albedo=0.75),
            sphere(18).placed((0, -80, -20), albedo=0.8),
        ),
    )


def _steps_at(x: float, y: float, texture: Texture | None, albedo: tuple[float, float, float]) -> tuple[Shape, ...]:
    """Three treads side by side, 12 and 27 mm apart, in front of z = 68."""
    heights = (22.0, 34.0, 61.0)
    return tuple(
        box(34, 90, height).placed((x + 34 * i, y, 68 - height / 2), albedo=albedo, texture=texture)
        for i, height in enumerate(heights)
    )


def _steps() -> Scene:
    low = tuple(
        box(150, 22, depth).placed((95, -85 + 24 * i, 68 - depth / 2), albedo=0.7)
        for i, depth in enumerate((5.0, 14.0, 30.0, 55.0, 90.0))
    )
    return Scene("steps", (board(0.8), *_steps_at(-150, 0, None, (0.75, 0.75, 0.75)), *low))


def _face() -> Scene:
    texture = Texture(smooth=0.12, smooth_mm=35.0, speckle=0.06, speckle_mm=2.5)
    return Scene("face", (relief(190, 260, 82).placed((0, 0, 45), albedo=SKIN, texture=texture),))


def _isolated() -> Scene:
    return Scene(
        "isolated",
        (
            sphere(42).placed((-120, -70, 30), albedo=(0.8, 0.6, 0.5), texture=COLORED),
            sphere(26).placed((-25, 85, -50), albedo=(0.6, 0.75, 0.7), texture=COLORED),
            box(60, 60, 50).placed((105, 85, 40), turn=(0.3, 0.5, 0.1), albedo=(0.6, 0.65, 0.8), texture=COLORED),
            cylinder(20, 110).placed((-130, 70, -20), turn=(0.1, 0.0, 0.5), albedo=0.75, texture=COLORED),
            rectangle(80, 60).placed((125, -80, -45), turn=(0.2, -0.4, 0.0), albedo=0.8, texture=COLORED),
            relief(85, 120, 40).placed((0, -55, 10), albedo=SKIN, texture=COLORED),
        ),
    )


def _mixed() -> Scene:
    return Scene(
        "mixed",
        (
            board((0.75, 0.72, 0.68), COLORED),
            relief(130, 185, 62).placed((30, 8, 40), albedo=SKIN, texture=COLORED),
            sphere(48).placed((-130, -75, 8), albedo=(0.70, 0.72, 0.62), texture=COLORED),
            sphere(30).placed((-50, -108, 15), albedo=(0.62, 0.66, 0.78), texture=COLORED),
            *_steps_at(-165, 75, COLORED, (0.72, 0.66, 0.60)),
            cylinder(3, 150).placed((-95, -5, -15), turn=(0.1, 0.0, 1.25), albedo=0.7, texture=COLORED),
            rectangle(105, 90).placed((150, -88, 25), turn=(0.17, -0.6, 0.0), albedo=(0.6, 0.7, 0.7), texture=COLORED),
            cylinder(26, 110).placed((152, 75, 20), turn=(0.15, 0.0, 0.2), albedo=(0.75, 0.7, 0.6), texture=COLORED),
        ),
    )


def _moving() -> Scene:
    head = Motion(swing_mm=(18, 6, 14), turn_rad=0.38, axis=(0.1, 1.0, 0.0))
    ball = Motion(swing_mm=(10, 42, 16), turn_rad=0.0, phase_rad=1.0)
    small = Motion(swing_mm=(-24, 26, 22), cycles=2, phase_rad=2.2)
    texture = Texture(smooth=0.2, smooth_mm=30.0, speckle=0.06, speckle_mm=2.5)
    return Scene(
        "moving",
        (
            board((0.62, 0.66, 0.70), Texture(smooth=0.15, smooth_mm=60.0)),
            relief(165, 235, 74).placed((5, 0, 22), albedo=SKIN, texture=texture, motion=head),
            sphere(34).placed((-145, -20, 10), albedo=(0.75, 0.55, 0.5), texture=texture, motion=ball),
            sphere(24).placed((140, 40, 0), albedo=(0.55, 0.62, 0.78), texture=texture, motion=small),
            box(50, 50, 50).placed(
                (145, -95, 20), turn=(0.4, 0.6, 0.0), albedo=(0.6, 0.72, 0.6), motion=Motion(turn_rad=0.5)
            ),
        ),
    )


_SCENES: dict[str, Callable[[], Scene]] = {
    "plane": _plane,
    "spheres": _spheres,
    "steps": _steps,
    "face": _face,
    "isolated": _isolated,
    "mixed": _mixed,
    "moving": _moving,
    "rims": hard_scenes.rims,
    "slots": hard_scenes.slots,
    "bars": hard_scenes.bars,
    "steep": hard_scenes.steep,
    "hand": hard_scenes.hand,
    "bright": hard_scenes.bright,
    "gloss": hard_scenes.gloss,
    "beyond": hard_scenes.beyond_volume,
    "cast": hard_scenes.cast,
    "colors": hard_scenes.strong_colors,
    "printed": hard_scenes.printed,
    "balls": hard_scenes.balls,
    "white": lambda: hard_scenes.white(_mixed()),
    "white-bars": lambda: hard_scenes.white(hard_scenes.bars()),
    "white-slots": lambda: hard_scenes.white(hard_scenes.slots()),
}
NAMES = (*_SCENES, "mesh")
