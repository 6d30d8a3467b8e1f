"""An interpreter of one page's content stream, for the part of PDF that the boards use."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

MM = 25.4 / 72


@dataclass
class Drawn:
    """The contents of a page, in mm from its upper left corner."""

    size_mm: tuple[float, float]
    discs: list[np.ndarray] = field(default_factory=list)  # outlines, (n, 2), sampled along the Bezier curves
    rectangles: list[tuple[float, float, float, float]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    info: str = ""


def read_pdf(data: bytes) -> Drawn:
    """Read the only page; assert that the table of objects points at the objects."""
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", data)[1])
    entries = re.findall(rb"(\d{10}) 00000 n", data[start:])
    for number, entry in enumerate(entries, 1):
        assert data[int(entry) :].startswith(b"%d 0 obj\n" % number)
    box = [float(x) for x in re.search(rb"/MediaBox \[([^\]]*)\]", data)[1].split()]
    length = int(re.search(rb"/Length (\d+)", data)[1])
    at = data.index(b"stream\n") + 7
    content = data[at : at + length].decode("latin-1")
    assert data[at + length :].startswith(b"\nendstream")
    drawn = Drawn(((box[2] - box[0]) * MM, (box[3] - box[1]) * MM))
    drawn.info = data[int(entries[-1]) :].split(b"endobj")[0].decode("latin-1")
    _interpret(content, drawn, box[3])
    return drawn


def _interpret(content: str, drawn: Drawn, height_pt: float) -> None:
    texts = re.compile(r"\(((?:[^()\\]|\\.)*)\) Tj")
    drawn.texts += texts.findall(content)
    stack: list[float] = []
    matrix = np.eye(3)
    path: list[np.ndarray] = []

    def point(x: float, y: float) -> np.ndarray:
        u, v, _ = np.array([x, y, 1.0]) @ matrix
        return np.array([u * MM, (height_pt - v) * MM])

    for token in texts.sub("", content).split():
        if re.fullmatch(r"-?\d*\.?\d+", token):
            stack.append(float(token))
            continue
        if token == "cm":
            a, b, c, d, e, f = stack
            matrix = np.array([[a, b, 0], [c, d, 0], [e, f, 1]]) @ matrix
        elif token == "m":
            path = [point(*stack)]
        elif token == "c":
            p0, p1, p2, p3 = path[-1], point(*stack[:2]), point(*stack[2:4]), point(*stack[4:])
            for t in np.linspace(0, 1, 17)[1:]:
                s = 1 - t
                path.append(s**3 * p0 + 3 * s * s * t * p1 + 3 * s * t * t * p2 + t**3 * p3)
        elif token == "re":
            x, y, w, h = stack
            (x0, y0), (x1, y1) = point(x, y), point(x + w, y + h)
            drawn.rectangles.append((x0, y0, x1, y1))
        elif token == "f" and path:
            drawn.discs.append(np.array(path))
            path = []
        stack = []
