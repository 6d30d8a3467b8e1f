"""Scenes in which wrong points arise: rims, slots, bars, steep sides, occlusion, gloss, print, limits of the volume.

Stage coordinates as in :mod:`sim.scene.named_scenes`; the standard field is about 420 x 335 mm, 230 mm deep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.scene.printed_marks import Ink
from sim.scene.scene import SKIN, Scene, board
from sim.scene.shapes import COLORED, Shape, Texture, Triple, box, cylinder, rectangle, relief, sphere

_STAINS = Texture(smooth=0.2, smooth_mm=30.0, speckle=0.05, speckle_mm=2.5)


def rims() -> Scene:
    """A wall wider than the field, so that each camera sees a strip that the other does not, and blocks at the rims."""
    return Scene(
        "rims",
        (
            rectangle(900, 700).placed((0, 0, 75), turn=(0.03, 0.05, 0.0), albedo=(0.7, 0.72, 0.68), texture=COLORED),
            box(60, 130, 70).placed((-205, -60, 20), turn=(0.0, 0.2, 0.0), albedo=0.75, texture=_STAINS),
            box(60, 110, 40).placed((205, 70, -10), turn=(0.1, -0.2, 0.0), albedo=(0.7, 0.6, 0.6), texture=_STAINS),
            sphere(38).placed((-195, 95, -20), albedo=0.7, texture=COLORED),
            sphere(30).placed((195, -90, 10), albedo=(0.6, 0.7, 0.75), texture=COLORED),
            box(120, 50, 60).placed((0, 160, 20), albedo=0.7, texture=COLORED),
        ),
    )


def slots() -> Scene:
    """Plates with slots of 3 to 8 mm, upright, level and inclined, 15 to 70 mm in front of the board."""
    bars: list[Shape] = []
    for k in range(9):
        bars.append(rectangle(5, 110).placed((-185 + 10 * k, -85, 40), albedo=0.75, texture=_STAINS))
        bars.append(rectangle(8, 100).placed((-20 + 14 * k, -90, 0), albedo=(0.7, 0.65, 0.6), texture=_STAINS))
        bars.append(rectangle(90, 5).placed((-130, 40 + 11 * k, 53), albedo=0.7, texture=_STAINS))
        bars.append(rectangle(4, 120).placed((40 + 9 * k, 80, 20), turn=(0.0, 0.0, 0.3), albedo=0.8, texture=_STAINS))
        bars.append(box(3, 80, 3).placed((135 + 7 * k, -90, 30), albedo=0.75))
    return Scene("slots", (board((0.72, 0.7, 0.74), COLORED), *bars))


def bars() -> Scene:
    """Round bars of 1 to 8 mm radius at all angles, near and far from the board."""
    rods = tuple(
        cylinder(radius, 240).placed(
            (-170 + 42 * i, 0, 50 - 16 * i), turn=(0.08 * i - 0.3, 0.0, -0.5 + 0.14 * i), albedo=0.7, texture=_STAINS
        )
        for i, radius in enumerate((1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0))
    )
    level = tuple(
        cylinder(radius, 330).placed((0, -130 + 75 * i, 45 - 25 * i), turn=(0.0, 0.0, 1.5708), albedo=0.65)
        for i, radius in enumerate((1.5, 3.0, 5.0, 7.0))
    )
    return Scene("bars", (board(0.7, COLORED), *rods, *level))


def steep() -> Scene:
    """Balls and tubes whose sides run along the line of sight, some close to each other."""
    balls = tuple(
        sphere(radius).placed((x, y, z), albedo=albedo, texture=COLORED)
        for radius, x, y, z, albedo in (
            (55.0, -130, -60, 10.0, (0.7, 0.65, 0.6)),
            (40.0, -20, -85, 30.0, (0.6, 0.7, 0.65)),
            (25.0, 45, -95, -20.0, (0.75, 0.7, 0.7)),
            (70.0, 130, -40, -5.0, (0.65, 0.7, 0.75)),
            (15.0, -60, 10, -60.0, (0.8, 0.7, 0.6)),
            (12.0, 20, 20, 55.0, (0.7, 0.7, 0.7)),
        )
    )
    tubes = (
        cylinder(30, 130).placed((-120, 85, 20), turn=(0.0, 0.0, 0.1), albedo=0.7, texture=_STAINS),
        cylinder(22, 130).placed((-40, 90, 0), turn=(0.6, 0.0, 0.0), albedo=0.75, texture=_STAINS),
        cylinder(45, 60).placed((70, 95, 10), turn=(1.2, 0.3, 0.0), albedo=(0.7, 0.62, 0.6), texture=COLORED),
        cylinder(16, 140).placed((160, 90, -40), turn=(0.2, 0.0, -0.3), albedo=0.7, texture=_STAINS),
    )
    return Scene("steep", (board((0.7, 0.68, 0.66), COLORED), *balls, *tubes))


def hand() -> Scene:
    """A hand in front of a face: fingers that hide strips of what is behind from one camera and from the projector."""
    fingers = tuple(
        cylinder(9, 105).placed(
            (-75 + 24 * i, -15 - 9 * (i % 2), -70 + 4 * i),
            turn=(0.25, 0.0, -0.28 + 0.16 * i),
            albedo=SKIN,
            texture=_STAINS,
        )
        for i in range(4)
    )
    return Scene(
        "hand",
        (
            board((0.66, 0.68, 0.7), COLORED),
            relief(170, 240, 78).placed((15, 0, 40), albedo=SKIN, texture=_STAINS),
            *fingers,
            relief(95, 95, 26, variant="waves").placed(
                (-40, 75, -62), turn=(0.1, 0.15, 0.0), albedo=SKIN, texture=_STAINS
            ),
            cylinder(11, 70).placed((40, 60, -55), turn=(0.2, 0.0, 0.9), albedo=SKIN, texture=_STAINS),
            cylinder(24, 140).placed((-75, 150, -40), turn=(0.3, 0.0, 0.4), albedo=SKIN, texture=_STAINS),
        ),
    )


def bright() -> Scene:
    """A white board and white objects beside darker ones; over-exposed, background and objects are saturated."""
    return Scene(
        "bright",
        (
            board(0.98),
            sphere(45).placed((-120, -60, 0), albedo=0.98),
            relief(130, 180, 60).placed((20, 10, 35), albedo=SKIN, texture=_STAINS),
            box(70, 70, 50).placed((135, -80, 20), turn=(0.3, 0.5, 0.0), albedo=(0.95, 0.9, 0.4)),
            sphere(32).placed((-120, 85, 5), albedo=(0.4, 0.5, 0.95), texture=_STAINS),
            cylinder(18, 120).placed((140, 75, 0), turn=(0.2, 0.0, 0.3), albedo=0.35, texture=_STAINS),
            box(8, 140, 8).placed((-40, -70, -30), turn=(0.0, 0.3, 0.2), albedo=0.9),
        ),
    )


def gloss() -> Scene:
    """Glossy, dark and saturated-colour parts."""
    return Scene(
        "gloss",
        (
            board((0.45, 0.47, 0.5), _STAINS),
            sphere(45).placed((-120, -65, 0), albedo=(0.35, 0.3, 0.3), gloss=(0.9, 60.0)),
            sphere(30).placed((-30, -90, -20), albedo=0.06, gloss=(0.4, 200.0)),
            cylinder(24, 130).placed((60, -60, 5), turn=(0.2, 0.0, 0.4), albedo=(0.6, 0.12, 0.1), gloss=(0.7, 90.0)),
            box(70, 80, 60).placed((145, -50, 10), turn=(0.2, 0.55, 0.0), albedo=0.12, gloss=(0.3, 40.0)),
            relief(110, 150, 50).placed((0, 65, 35), albedo=(0.2, 0.35, 0.6), texture=COLORED, gloss=(0.5, 80.0)),
            rectangle(80, 70).placed((-135, 70, 10), turn=(0.0, 0.35, 0.0), albedo=0.05),
            sphere(28).placed((130, 85, 0), albedo=(0.75, 0.7, 0.1), gloss=(1.0, 300.0)),
        ),
    )


def beyond_volume() -> Scene:
    """Half of it outside the volume: a wall far behind, an inclined plate through both limits, a rod too near."""
    return Scene(
        "beyond volume",
        (
            rectangle(1200, 900).placed((0, 0, 420), albedo=0.8, texture=COLORED),
            rectangle(150, 260).placed((-110, 0, 20), turn=(0.0, 1.15, 0.0), albedo=0.75, texture=_STAINS),
            rectangle(150, 120).placed((90, -80, 105), turn=(0.7, 0.0, 0.0), albedo=0.75, texture=_STAINS),
            sphere(40).placed((40, 70, 20), albedo=(0.7, 0.6, 0.55), texture=COLORED),
            cylinder(12, 300).placed((150, 40, -190), turn=(0.2, 0.0, 0.25), albedo=0.6, texture=_STAINS),
            sphere(30).placed((120, 90, 150), albedo=0.7, texture=COLORED),
        ),
    )


def cast() -> Scene:
    """A plaster cast of teeth before a dark wall behind the volume: two arches of small blocks with narrow gaps."""
    rng = np.random.default_rng(5)
    plaster = Texture(smooth=0.04, smooth_mm=20.0, speckle=0.02, speckle_mm=1.5)
    shapes: list[Shape] = [
        rectangle(1000, 800).placed((0, 0, 180), turn=(0.1, 0.2, 0.0), albedo=0.35),
        cylinder(95, 40).placed((0, 20, 40), turn=(1.35, 0.0, 0.0), albedo=0.8, texture=plaster),
    ]
    for radius_y, depth in ((70, 5.0), (60, -25.0)):
        for k, angle in enumerate(np.pi * np.linspace(0.04, 0.96, 14)):
            x, y = float(75 * np.cos(angle)), float(30 - radius_y * np.sin(angle))
            width, height = rng.uniform(5.5, 9), rng.uniform(12, 22)
            turn = (rng.normal(0, 0.2), rng.normal(0, 0.2), float(angle + np.pi / 2))
            tooth = box(1.5 * width, width, height)
            shapes.append(tooth.placed((x, y, depth), turn=turn, albedo=0.8, texture=plaster))
            if k % 3 == 0:
                shapes.append(sphere(width).placed((x, y, depth - 6), albedo=0.8, texture=plaster))
    return Scene("cast", tuple(shapes))


def strong_colors() -> Scene:
    """Surfaces whose channels reflect 2.5 to 8 times as much as each other, before a wall that is one of them."""
    return Scene(
        "colors",
        (
            board((0.85, 0.75, 0.12)),
            sphere(45).placed((-110, -60, 10), albedo=(0.12, 0.25, 0.65)),
            sphere(34).placed((0, -80, 0), albedo=(0.85, 0.4, 0.1), texture=_STAINS),
            box(70, 60, 50).placed((100, -60, 20), turn=(0.1, 0.4, 0.0), albedo=(0.2, 0.46, 0.48), texture=_STAINS),
            cylinder(28, 120).placed((-90, 80, 20), turn=(0.0, 0.0, 1.2), albedo=(0.16, 0.55, 0.15)),
            relief(90, 110, 40).placed((60, 75, 35), albedo=(0.65, 0.16, 0.14)),
        ),
    )


def printed() -> Scene:
    """Plates with print on them before a bare wall: a chessboard, discs, lines as far apart as the fringes, letters."""
    fields = [(10.0 * i - 60, 10.0 * j - 45) for i in range(12) for j in range(i % 2, 9, 2)]
    chessboard = [(x, y, x + 10, y + 10) for x, y in fields]
    discs = [(10.0 * i - 50, 10.0 * j - 40, 4.0) for i in range(11) for j in range(9)]
    lines = [(4.0 * k - 70, -50.0, 4.0 * k - 68, 50.0) for k in range(35)]
    return Scene(
        "printed",
        (
            board(0.8),
            _print(squares=chessboard).placed((-105, -75, 10), turn=(0.1, 0.3, 0.1), albedo=0.9),
            _print(discs=discs).placed((90, -70, -10), turn=(0.2, -0.3, -0.1), albedo=0.9),
            _print(squares=lines).placed((-90, 70, 20), turn=(-0.1, 0.2, 0.05), albedo=0.9),
            _print(squares=_letters(6.0)).placed((90, 75, 0), turn=(0.2, 0.3, 0.0), albedo=0.9),
        ),
    )


def balls() -> Scene:
    """Many white balls of 10 to 26 mm at all depths before a white board: no texture, and steps of any height."""
    rng = np.random.default_rng(2)
    many = tuple(
        sphere(rng.uniform(5, 13)).placed((rng.uniform(-190, 190), rng.uniform(-150, 150), rng.uniform(-90, 55)))
        for _ in range(110)
    )
    return Scene("balls", (board(0.75), *many))


def white(scene: Scene) -> Scene:
    """The same shapes, all white, matt and without texture."""
    return replace(scene, shapes=tuple(replace(shape, albedo=(0.8,) * 3, texture=Texture()) for shape in scene.shapes))


def _print(*, discs: Sequence[Triple] = (), squares: Sequence[tuple[float, float, float, float]] = ()) -> Shape:
    """A plate with these black marks on its front."""
    marks = Ink(np.array(discs, float).reshape(-1, 3), np.array(squares, float).reshape(-1, 4), 0.07)
    return rectangle(150, 110, ink=marks)


def _letters(size_mm: float) -> list[tuple[float, float, float, float]]:
    """Strokes of a page of letters: each one or two uprights, and a bar between them at one of three heights."""
    rng, stroke, strokes = np.random.default_rng(3), 0.16 * size_mm, []
    for y in np.arange(-48.0, 48.0 - size_mm, 1.7 * size_mm):
        for x in np.arange(-70.0, 70.0 - size_mm, 0.9 * size_mm):
            if rng.random() < 0.15:
                continue  # a gap in the line
            height = y + size_mm * rng.choice([0.0, 0.42, 0.84])
            strokes.append((x, y, x + stroke, y + size_mm))
            strokes.append((x + stroke, height, x + 0.45 * size_mm, height + stroke))
            if rng.random() < 0.5:
                strokes.append((x + 0.45 * size_mm, y, x + 0.45 * size_mm + stroke, y + size_mm))
    return strokes
