"""``python -m sim.evaluate.write_pair SCENE FOLDER``: one pair of a scene as PNG files, with truth and rig files.

Options of the rig follow as ``key=value`` of its optics, for instance ``defocus_px=1.5 gamma=2.2``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np

from sim.render.render_pair import RenderedPair, render_pair
from sim.rig import rig_files
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene import named_scenes


def write_pair(pair: RenderedPair, folder: Path) -> None:
    """``left.png``, ``right.png`` and ``truth_left.npz``, ``truth_right.npz`` in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for side, image, truth in (("left", pair.left, pair.truth_left), ("right", pair.right, pair.truth_right)):
        bgr = image[..., ::-1] if image.ndim == 3 else image
        if not cv2.imwrite(str(folder / f"{side}.png"), bgr):
            raise OSError(f"{folder / side}.png cannot be written")
        np.savez_compressed(folder / f"truth_{side}.npz", allow_pickle=False, **truth.arrays())


def main(arguments: list[str]) -> int:
    """Render and write the pair, and print one line about it."""
    if len(arguments) < 2:
        sys.stderr.write(f"{__doc__}Scenes: {', '.join(named_scenes.NAMES)}; a path means the mesh in that file.\n")
        return 2
    name, folder, *changes = arguments
    optics = Optics(**{key: json.loads(value) for key, _, value in (item.partition("=") for item in changes)})
    mesh_file = None if name in named_scenes.NAMES else Path(name)
    layout, scene = RigLayout(), named_scenes.build("mesh" if mesh_file else name, mesh_file=mesh_file)
    pair = render_pair(layout, scene, layout.pattern(), optics)
    write_pair(pair, Path(folder))
    for file, mapping in (
        ("calibration.json", rig_files.calibration_mapping(layout, optics)),
        ("pattern.json", rig_files.pattern_mapping(layout)),
        ("volume.json", rig_files.volume_mapping(layout)),
    ):
        (Path(folder) / file).write_text(json.dumps(mapping, indent=1))
    share = float(pair.truth_left.scorable.mean())
    sys.stdout.write(f"{scene.name}: brightest {int(pair.left.max())}, measurable {share:.1%} of the left image\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
