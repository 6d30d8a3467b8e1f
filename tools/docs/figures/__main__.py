"""Draw all figures into docs/images: ``python -m tools.docs.figures [--scale 1.0]``; a few minutes."""

from __future__ import annotations

import argparse

from sim.scene.named_scenes import build
from tools.docs.figures import diagrams, parts, plots
from tools.docs.figures.measure import measure, objects
from tools.docs.pages import DOCS

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scale", type=float, default=1.0, help="of the images' size")
parser.add_argument("--diagrams", action="store_true", help="only the drawings, which need no measurement")
options = parser.parse_args()
written = diagrams.draw(DOCS / "images")
if not options.diagrams:
    written += plots.draw(measure(build("mixed"), scale=options.scale), DOCS / "images")
    written += plots.draw(measure(objects(), scale=options.scale), DOCS / "images", plots.HERO)
    written += parts.draw(build("isolated"), DOCS / "images", scale=options.scale)
for path in written:
    print(path)
