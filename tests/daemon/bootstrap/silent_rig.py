"""A rig whose cameras are there but never see a trigger; stands for real hardware and imports no simulator."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.protocols import CameraHealth, CameraInfo, Frame, ProjectorInfo
from pipeline.pattern.color_fringe import ColorFringe

SIZE, PROJECTOR = (96, 64), (128, 102)


class Camera:
    def __init__(self, side: str) -> None:
        self.side = side

    def open(self) -> CameraInfo:
        return CameraInfo("silent", self.side, SIZE, "rgb8")

    def start(self) -> None:
        pass

    def read(self, timeout_s: float) -> Frame | None:
        time.sleep(timeout_s)
        return None

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def health(self) -> CameraHealth:
        return CameraHealth()


class Projector:
    def open(self) -> ProjectorInfo:
        return ProjectorInfo("none", PROJECTOR, 0.0)

    def show(self, image: Any) -> None:
        assert image.dtype == np.uint8

    def problem(self) -> str:
        return ""

    def close(self) -> None:
        pass


@dataclass
class Devices:
    cameras: dict[str, Camera]
    projector: Projector
    board: None = None

    def close(self) -> None:
        pass


def open_rig(options: dict[str, Any], base_dir: Path, *, progress: Any = None) -> Devices:
    assert options["cameras"]["driver"] == "silent" and base_dir.is_dir() and progress is not None
    return Devices({side: Camera(side) for side in ("left", "right")}, Projector())


def write(directory: Path) -> None:
    """rig.yaml and all the files that it names."""
    f = 320.0

    def device(size: tuple[int, int], focal: float, x_mm: float) -> dict[str, Any]:
        matrix = [[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]]
        eye = np.eye(3).tolist()
        return {
            "size": list(size),
            "matrix": matrix,
            "distortion": [0] * 5,
            "rotation": eye,
            "translation": [-x_mm, 0, 0],
        }

    calibration = {
        "fringed_calibration": 1,
        "cameras": {"left": device(SIZE, f, 0), "right": device(SIZE, f, 100)},
        "projector": device(PROJECTOR, f, 38),
    }
    (directory / "calibration.yaml").write_text(yaml.safe_dump(calibration))
    (directory / "pattern.json").write_text(json.dumps(ColorFringe(size=PROJECTOR, periods=10).as_mapping()))
    (directory / "rig.yaml").write_text(
        f"cameras: {{driver: silent}}\ncalibration: calibration.yaml\npattern: pattern.json\n"
        f"volume: {{near_mm: 1200, far_mm: 1500}}\nstream: {{endpoints: ['ipc://{directory}/s']}}\n"
        f"control: {{endpoint: 'ipc://{directory}/c'}}\n"
    )
