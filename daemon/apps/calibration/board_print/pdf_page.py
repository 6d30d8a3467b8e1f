"""One page of PDF with black shapes to scale, in millimetres from the upper left corner; see ISO 32000-1."""

from __future__ import annotations

import math

POINTS_PER_MM = 72 / 25.4
ARCS = 8
_REACH = 4 / 3 * math.tan(math.pi / (2 * ARCS))
"""Length of a Bezier curve's handles for an arc of 45 degrees of the unit circle. The curve meets the circle at both
ends and in the middle of the arc; between them it lies outside by at most 4.2e-6 of the radius: 0.04 um at 10 mm."""


class Page:
    """Collects shapes; :meth:`data` gives the file.

    Args:
        width_mm, height_mm: of the paper.
        title, subject: the document's information entries.
    """

    def __init__(self, width_mm: float, height_mm: float, *, title: str, subject: str) -> None:
        self.width_mm, self.height_mm = width_mm, height_mm
        self._title, self._subject = title, subject
        scale = POINTS_PER_MM
        # From here on coordinates are millimetres and y grows downwards.
        self._drawn = [f"{scale:.10f} 0 0 {-scale:.10f} 0 {height_mm * scale:.6f} cm", "0 g 0 G"]

    def disc(self, x: float, y: float, radius: float) -> None:
        """A filled circle with its centre at (x, y)."""
        out = [f"{_n(x + radius)} {_n(y)} m"]
        for arc in range(ARCS):
            a, b = 2 * math.pi * arc / ARCS, 2 * math.pi * (arc + 1) / ARCS
            handles = (
                (math.cos(a) - _REACH * math.sin(a), math.sin(a) + _REACH * math.cos(a)),
                (math.cos(b) + _REACH * math.sin(b), math.sin(b) - _REACH * math.cos(b)),
                (math.cos(b), math.sin(b)),
            )
            out.append(" ".join(f"{_n(x + radius * p)} {_n(y + radius * q)}" for p, q in handles) + " c")
        self._drawn.append(" ".join([*out, "f"]))

    def rectangles(self, corners: list[tuple[float, float, float, float]]) -> None:
        """Filled rectangles x0, y0, x1, y1, as one path, so that neighbours leave no hairline between them."""
        path = [f"{_n(x0)} {_n(y0)} {_n(x1 - x0)} {_n(y1 - y0)} re" for x0, y0, x1, y1 in corners]
        self._drawn.append(" ".join([*path, "f"]))

    def text(self, x: float, y: float, size_mm: float, text: str) -> None:
        """A line of text in Helvetica, the left end of its base line at (x, y)."""
        self._drawn.append(f"BT /F1 {_n(size_mm)} Tf 1 0 0 -1 {_n(x)} {_n(y)} Tm ({_escaped(text)}) Tj ET")

    def data(self) -> bytes:
        """The bytes of the file."""
        content = "\n".join(self._drawn).encode("latin-1")
        box = f"[0 0 {self.width_mm * POINTS_PER_MM:.6f} {self.height_mm * POINTS_PER_MM:.6f}]"
        objects = [
            # Viewers that honour it print at 100 % without asking.
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
            "/Resources << /Font << /F1 5 0 R >> >> >>".encode("latin-1"),
            b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
            f"<< /Title ({_escaped(self._title)}) /Subject ({_escaped(self._subject)}) /Creator (fringed) >>".encode(
                "latin-1"
            ),
        ]
        out = bytearray(b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n")
        offsets = []
        for number, data in enumerate(objects, 1):
            offsets.append(len(out))
            out += b"%d 0 obj\n%s\nendobj\n" % (number, data)
        table = len(out)
        out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
        out += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
        out += b"trailer\n<< /Size %d /Root 1 0 R /Info 6 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
        return bytes(out)


def _n(value: float) -> str:
    """Format millimetres to 10 nm, without an exponent, which PDF does not allow."""
    return f"{value:.5f}".rstrip("0").rstrip(".").replace("-0", "0") if abs(value) < 5e-6 else f"{value:.5f}"


def _escaped(text: str) -> str:
    plain = "".join(c if 32 <= ord(c) < 127 else "?" for c in text)
    return plain.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
