"""A scene: shapes on the stage, with a period of motion."""

from __future__ import annotations

from dataclasses import dataclass

from sim.scene.shapes import Shape, Texture, rectangle

SKIN = (0.78, 0.60, 0.50)


@dataclass(frozen=True, slots=True)
class Scene:
    """Shapes on the stage; the motion repeats after ``period_s``."""

    name: str
    shapes: tuple[Shape, ...]
    period_s: float = 3.0

    @property
    def moves(self) -> bool:
        """Whether anything moves."""
        return any(shape.motion is not None for shape in self.shapes)

    def share(self, t_s: float) -> float:
        """Share of the period at a time."""
        return (t_s / self.period_s) % 1.0


def board(albedo: float | tuple[float, float, float], texture: Texture | None = None) -> Shape:
    """The board behind most scenes: 430 x 330 mm at z = 68."""
    return rectangle(430, 330).placed((0, 0, 68), albedo=albedo, texture=texture)
