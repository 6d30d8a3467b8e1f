"""Drawings with text as text: wiring, timing, architecture and the geometry of a rig."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from sim.rig.layout import RigLayout

_STYLE = (
    'text{font:13px system-ui,"DejaVu Sans",Arial,sans-serif;fill:#1d2733}.name{font-weight:600;text-anchor:middle}'
    ".note{font-size:12px;fill:#5a6672}.mid{text-anchor:middle}.end{text-anchor:end}.box{fill:#fff;stroke:#1668b0;stroke-width:1.4}"
    ".out{fill:#eef6ee;stroke:#1d7d4a;stroke-width:1.4}.side{fill:#f5f7f9;stroke:#8a96a3}"
    ".data{fill:none;stroke:#44505c;stroke-width:1.4}.trigger{fill:none;stroke:#c2410c;stroke-width:2}"
    ".light{fill:#f6c945;fill-opacity:.18;stroke:#c79a12;stroke-width:.8}.view{fill:#1668b0;fill-opacity:.10;stroke:#1668b0;stroke-width:.8}"
    ".channel0{fill:#f19a9d}.channel1{fill:#8ecbab}.channel2{fill:#98aaeb}"
    ".volume{fill:#1d7d4a;fill-opacity:.16;stroke:#1d7d4a;stroke-width:1.2}.on{fill:#f6c945;stroke:#c79a12}.grey{fill:#dbe3ea;stroke:#8a96a3}"
)


class Drawing:
    """An SVG drawing."""

    def __init__(self, title: str, width: int, height: int) -> None:
        self._head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            f'role="img" aria-labelledby="t">\n<title id="t">{escape(title)}</title>\n<style>{_STYLE}</style>\n'
            '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            'orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="context-stroke"/></marker></defs>\n'
            f'<rect width="{width}" height="{height}" fill="#fff"/>'
        )
        self._parts: list[str] = []

    def text(self, x: float, y: float, text: str, kind: str = "") -> None:
        """Write a line of text."""
        self._parts.append(f'<text class="{kind}" x="{x:g}" y="{y:g}">{escape(text)}</text>')

    def box(self, x: float, y: float, width: float, height: float, name: str, *notes: str, kind: str = "box") -> None:
        """Draw a box with a name and notes, centred."""
        self._parts.append(f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6"/>')
        first = y + height / 2 + 5 - 8 * len(notes)
        self.text(x + width / 2, first, name, "name")
        for number, note in enumerate(notes, 1):
            self.text(x + width / 2, first + 16 * number, note, "note mid")

    def line(self, *points: tuple[float, float], kind: str = "data", arrow: bool = True) -> None:
        """Draw a line through points."""
        path = " L".join(f"{x:g} {y:g}" for x, y in points)
        end = ' marker-end="url(#head)"' if arrow else ""
        self._parts.append(f'<path class="{kind}" d="M{path}"{end}/>')

    def area(self, *points: tuple[float, float], kind: str) -> None:
        """Draw a polygon."""
        self._parts.append(f'<polygon class="{kind}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>')

    def save(self, path: Path) -> Path:
        """Write the file."""
        path.write_text("\n".join([self._head, *self._parts, "</svg>"]) + "\n", encoding="utf-8")
        return path


def draw(folder: Path) -> list[Path]:
    """Draw all of them."""
    drawings = {
        "architecture.svg": architecture(),
        "geometry.svg": geometry(),
        "timing.svg": timing(),
        "wiring-projector.svg": wiring(
            "Wiring: the projector triggers both cameras", "Projector", "with trigger output", source=False
        ),
        "wiring-source.svg": wiring(
            "Wiring: a common source triggers both cameras", "Projector", "without trigger output", source=True
        ),
    }
    return [drawing.save(folder / name) for name, drawing in drawings.items()]


def wiring(title: str, projector: str, note: str, *, source: bool) -> Drawing:
    """Trigger, data and video cables."""
    d = Drawing(title, 760, 330)
    d.box(40, 40, 150, 64, "Left camera", "trigger input: Line")
    d.box(305, 40, 150, 64, projector, note)
    d.box(570, 40, 150, 64, "Right camera", "trigger input: Line")
    d.box(250, 240, 260, 64, "PC", "fringed, graphics card output", kind="out")
    for camera, pc in ((90, 250), (670, 510)):
        d.line((camera, 104), (camera, 272), (pc, 272), arrow=False)
    d.text(100, 262, "image data", "note")
    d.text(660, 262, "image data", "note end")
    d.line((380, 240), (380, 104))
    d.text(388, 226, "video, RGB 4:4:4, native mode", "note")
    if source:
        d.box(492, 164, 160, 52, "Trigger source", "whole projector periods", kind="side")
        d.line((492, 190), (465, 190), (465, 150), (130, 150), (130, 104), kind="trigger")
        d.line((620, 164), (620, 104), kind="trigger")
        d.text(145, 143, "trigger: same edge, same delay", "note")
        d.text(612, 136, "level of the inputs, one ground", "note end")
    else:
        d.line((350, 104), (350, 150), (130, 150), (130, 104), kind="trigger")
        d.line((410, 104), (410, 150), (630, 150), (630, 104), kind="trigger")
        d.line((350, 150), (410, 150), kind="trigger", arrow=False)
        d.text(145, 143, "trigger: same edge, same delay", "note")
        d.text(425, 143, "level of the inputs, one ground", "note")
    return d


def timing() -> Drawing:
    """Exposure against the projector's periods."""
    d = Drawing("Timing: exposure of a whole number of projector periods", 760, 268)
    left, period = 150, 72
    d.text(140, 50, "projector, RGB", "end")
    for n in range(8):
        for channel in range(3):
            x, width = left + n * period + channel * period / 3, period / 3 - 1
            d.area((x, 32), (x + width, 32), (x + width, 58), (x, 58), kind=f"channel{channel}")
    d.text(140, 108, "trigger", "end")
    for n in (0, 3, 6):
        x = left + n * period + 14
        d.line((x, 118), (x, 94), (x + 12, 94), (x + 12, 118), kind="trigger", arrow=False)
    d.line((left, 118), (left + 8 * period, 118), kind="trigger", arrow=False)
    d.text(140, 160, "exposure, both", "end")
    for n in (0, 3, 6):
        d.area(
            *[(left + n * period + 14 + dx, y) for dx, y in ((0, 140), (period, 140), (period, 168), (0, 168))],
            kind="on",
        )
        d.text(left + n * period + 14 + period / 2, 159, "1 period", "note mid")
    d.text(140, 206, "readout", "end")
    for n in (0, 3):
        d.area(
            *[(left + n * period + 14 + period + dx, y) for dx, y in ((0, 188), (90, 188), (90, 214), (0, 214))],
            kind="grey",
        )
    d.text(left, 238, "The colours are shown one after the other; an exposure of whole periods", "note")
    d.text(left, 254, "receives all of them, wherever it begins.", "note")
    return d


def architecture() -> Drawing:
    """Processes and what flows between them."""
    d = Drawing("Architecture: processes of a rig", 820, 400)
    d.box(30, 40, 170, 60, "Left camera", "process: driver, ring")
    d.box(30, 130, 170, 60, "Right camera", "process: driver, ring")
    d.box(30, 240, 170, 60, "Projector window", "process: OpenGL, X11")
    d.area((250, 20), (580, 20), (580, 370), (250, 370), kind="side")
    d.text(262, 40, "daemon: fringed run", "note")
    d.box(270, 85, 130, 60, "Pairing", "by number, time")
    d.box(430, 85, 130, 60, "Pipeline", "pair to cloud")
    d.box(270, 225, 130, 60, "Health, drift", "limits, verdicts", kind="box")
    d.box(430, 180, 130, 56, "Publisher", "newest cloud")
    d.box(430, 256, 130, 56, "Recorder", "takes, *.mcap")
    d.text(415, 348, "Control: settings, status, JSON-RPC", "note mid")
    d.box(630, 40, 160, 60, "Gate", "keys, encryption", kind="side")
    d.box(630, 130, 160, 60, "Your programs", "fringed.subscribe", kind="out")
    d.box(630, 216, 160, 60, "Viewer", "Rerun, in a browser", kind="out")
    d.box(630, 302, 160, 60, "fringed status, set", "command line", kind="out")
    d.line((200, 70), (235, 70), (235, 105), (270, 105))
    d.line((200, 160), (235, 160), (235, 125), (270, 125))
    d.line((400, 115), (430, 115))
    d.line((495, 145), (495, 180))
    d.line((335, 145), (335, 225))
    d.line((365, 145), (365, 200), (412, 200), (412, 284), (430, 284))
    d.line((560, 200), (600, 200), (600, 160), (630, 160))
    d.line((600, 200), (600, 246), (630, 246))
    d.line((600, 160), (600, 70), (630, 70))
    d.line((630, 336), (580, 336))
    d.line((250, 270), (200, 270))
    d.text(225, 262, "image", "note mid")
    d.text(229, 94, "frames", "note end")
    d.text(415, 76, "pairs", "note mid")
    d.text(503, 168, "clouds", "note")
    return d


def geometry() -> Drawing:
    """The standard rig from above, to scale."""
    layout = RigLayout()
    d = Drawing("Geometry of the standard rig from above", 660, 664)
    scale, middle, top = 0.34, 330.0, 560.0
    height = layout.standoff_mm * np.sqrt(1 - (layout.baseline_mm / (2 * layout.standoff_mm)) ** 2)

    def at(x: float, z: float) -> tuple[float, float]:
        """Pixel of a point, x along the baseline from its middle, z away from it, mm."""
        return middle + scale * x, top - scale * z

    def beam(x: float, half_angle: float, kind: str) -> None:
        axis = np.arctan2(-x, height)
        reach = (height + layout.depth_mm / 2 + 40) / np.cos(axis)
        ends = [(x + reach * np.sin(axis + a), reach * np.cos(axis + a)) for a in (-half_angle, half_angle)]
        d.area(at(x, 0), at(*ends[0]), at(*ends[1]), kind=kind)

    half = layout.baseline_mm / 2
    projector = (layout.projector_fraction - 0.5) * layout.baseline_mm
    field = layout.camera_size[0] * layout.standoff_mm / layout.focal_px
    camera_angle = np.arctan(layout.camera_size[0] / 2 / layout.focal_px)
    beam(projector, float(np.arctan(layout.projector_size[0] / 2 / layout.projector_focal_px)), "light")
    for x in (-half, half):
        beam(x, float(camera_angle), "view")
    near, far = height - layout.depth_mm / 2, height + layout.depth_mm / 2
    d.area(at(-field / 2, near), at(field / 2, near), at(field / 2, far), at(-field / 2, far), kind="volume")
    d.text(middle, at(0, height)[1] - 4, "measuring volume", "name")
    d.text(middle, at(0, height)[1] + 14, f"{field:.0f} x {layout.depth_mm:.0f} mm", "mid")
    for x, name in ((-half, "left camera"), (projector, "projector"), (half, "right camera")):
        px, py = at(x, 0)
        d.area((px - 15, py), (px + 15, py), (px + 15, py + 22), (px - 15, py + 22), kind="grey")
        d.text(px, py + (56 if name == "projector" else 38), name, "mid")
    (lx, _), (rx, _) = at(-half, 0), at(half, 0)
    d.line((lx, 632), (rx, 632), arrow=False)
    d.text(
        middle,
        650,
        f"baseline {layout.baseline_mm:.0f} mm, projector at {layout.projector_fraction:g} of it",
        "note mid",
    )
    d.line((rx + 75, top), (rx + 75, at(0, height)[1]))
    d.text(rx + 85, (top + at(0, height)[1]) / 2, f"{layout.standoff_mm:.0f} mm", "note")
    return d
