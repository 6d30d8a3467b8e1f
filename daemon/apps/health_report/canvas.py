"""Drawing as SVG or as pixels with the same few operations. Coordinates and sizes are pixels."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]
Anchor = Literal["start", "middle", "end"]


class Canvas(Protocol):
    """Drawing operations; colours are ``#rrggbb``."""

    def rect(self, x: float, y: float, width: float, height: float, color: str, *, opacity: float = 1.0) -> None:
        """Draw a filled rectangle."""

    def line(self, points: Sequence[Point], color: str, width: float, *, dashed: bool = False) -> None:
        """Draw a polyline."""

    def area(self, points: Sequence[Point], color: str, *, opacity: float) -> None:
        """Draw a filled polygon."""

    def text(
        self, x: float, y: float, text: str, size: float, color: str, *, anchor: Anchor = "start", bold: bool = False
    ) -> None:
        """Draw one line of text on the base line y."""


class Svg:
    """Inline SVG of a given size."""

    def __init__(self, width: float, height: float) -> None:
        self._head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">'
        self._parts: list[str] = []

    def rect(self, x: float, y: float, width: float, height: float, color: str, *, opacity: float = 1.0) -> None:
        """Draw a filled rectangle."""
        bounds = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
        self._parts.append(f'<rect {bounds} fill="{color}" opacity="{opacity:g}"/>')

    def line(self, points: Sequence[Point], color: str, width: float, *, dashed: bool = False) -> None:
        """Draw a polyline."""
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        ends = ' stroke-linejoin="round" stroke-linecap="round"'
        self._parts.append(
            f'<path d="{_path(points)}" fill="none" stroke="{color}" stroke-width="{width:g}"{dash}{ends}/>'
        )

    def area(self, points: Sequence[Point], color: str, *, opacity: float) -> None:
        """Draw a filled polygon."""
        self._parts.append(f'<path d="{_path(points)}Z" fill="{color}" opacity="{opacity:g}"/>')

    def text(
        self, x: float, y: float, text: str, size: float, color: str, *, anchor: Anchor = "start", bold: bool = False
    ) -> None:
        """Draw one line of text."""
        weight = ' font-weight="600"' if bold else ""
        self._parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}" fill="{color}"{weight} '
            f'font-family="system-ui, Helvetica, Arial, sans-serif">{escape(text)}</text>'
        )

    def data(self) -> str:
        """The SVG element."""
        return "".join([self._head, *self._parts, "</svg>"])


class Pixels:
    """A raster image drawn by OpenCV, at twice the resolution of its coordinates."""

    FINE = 2

    def __init__(self, width: float, height: float) -> None:
        import cv2

        self._cv = cv2
        size = (round(self.FINE * height), round(self.FINE * width), 3)
        self._image = np.full(size, 255, np.uint8)
        self._face = cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None  # from OpenCV 5 on

    def rect(self, x: float, y: float, width: float, height: float, color: str, *, opacity: float = 1.0) -> None:
        """Draw a filled rectangle."""
        self.area([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], color, opacity=opacity)

    def line(self, points: Sequence[Point], color: str, width: float, *, dashed: bool = False) -> None:
        """Draw a polyline."""
        thick = max(1, round(self.FINE * width))
        for part in _dashes(points) if dashed else [points]:
            self._cv.polylines(self._image, [self._fixed(part)], False, _bgr(color), thick, self._cv.LINE_AA, _SHIFT)

    def area(self, points: Sequence[Point], color: str, *, opacity: float) -> None:
        """Draw a filled polygon."""
        polygon = self._fixed(points)
        low, high = polygon.min(axis=0) >> _SHIFT, (polygon.max(axis=0) >> _SHIFT) + 2
        region = self._image[max(0, low[1]) : max(0, high[1]), max(0, low[0]) : max(0, high[0])]
        if not region.size:
            return
        filled = region.copy()
        polygon -= np.maximum(low, 0) << _SHIFT
        self._cv.fillPoly(filled, [polygon], _bgr(color), self._cv.LINE_AA, _SHIFT)
        region[:] = self._cv.addWeighted(filled, opacity, region, 1 - opacity, 0)

    def text(
        self, x: float, y: float, text: str, size: float, color: str, *, anchor: Anchor = "start", bold: bool = False
    ) -> None:
        """Draw one line of text."""
        fine = round(self.FINE * size)
        width = self._width(text, fine, bold=bold)
        left = self.FINE * x - {"start": 0.0, "middle": width / 2, "end": width}[anchor]
        at = (round(left), round(self.FINE * y))
        if self._face is not None:
            self._cv.putText(self._image, text, at, _bgr(color), self._face, fine, _WEIGHT[bold])
        else:
            plain = _plain(text)
            scale = fine / _HERSHEY
            self._cv.putText(self._image, plain, at, 0, scale, _bgr(color), 1 + bold, self._cv.LINE_AA)

    def data(self) -> bytes:
        """The bytes of a PNG file."""
        encoded, data = self._cv.imencode(".png", self._image, [self._cv.IMWRITE_PNG_COMPRESSION, 9])
        if not encoded:
            raise ValueError("OpenCV cannot encode the image")
        return bytes(data)

    def _width(self, text: str, fine: int, *, bold: bool) -> float:
        if self._face is not None:
            box = self._cv.getTextSize((1, 1), text, (0, 0), self._face, fine, _WEIGHT[bold])
            return float(box[2])
        return float(self._cv.getTextSize(_plain(text), 0, fine / _HERSHEY, 1 + bold)[0][0])

    def _fixed(self, points: Sequence[Point]) -> NDArray[Any]:
        """Fixed-point coordinates for OpenCV."""
        return np.round(np.array(points) * self.FINE * (1 << _SHIFT)).astype(np.int32)


_SHIFT = 4
_WEIGHT = {False: 400, True: 600}
_HERSHEY = 30.0  # line height of the Hershey font at scale 1, pixels


def _plain(text: str) -> str:
    """Replace characters that the fonts of OpenCV 4 lack (all but ASCII)."""
    return text.replace("°", " deg ").replace("–", "-").replace("µ", "u").encode("ascii", "replace").decode()


def _bgr(color: str) -> tuple[int, int, int]:
    return int(color[5:7], 16), int(color[3:5], 16), int(color[1:3], 16)


def _path(points: Sequence[Point]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _dashes(points: Sequence[Point], length: float = 5.0, gap: float = 4.0) -> list[list[Point]]:
    """Split a polyline into dashes."""
    out: list[list[Point]] = []
    for (x0, y0), (x1, y1) in pairwise(points):
        length_px = float(np.hypot(x1 - x0, y1 - y0))
        for at in np.arange(0, length_px, length + gap):
            a, b = at / length_px, min(1.0, (at + length) / length_px)
            out.append([(x0 + a * (x1 - x0), y0 + a * (y1 - y0)), (x0 + b * (x1 - x0), y0 + b * (y1 - y0))])
    return out
