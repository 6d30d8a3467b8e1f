"""A session on disk: every accepted view as images, so that it can be solved again without any hardware."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from daemon.apps.calibration.guided.capture import Shots
from daemon.common.errors import DaemonError
from daemon.common.files import write_atomically
from daemon.recording.format.raw_image import Pixels
from pipeline.pattern.sequence import FrameSequence

CAPTURE = "capture.json"


class SessionFolder:
    """A capture folder that grows by one view after the other.

    Args:
        path: of a folder that is not there yet, or empty; made with the first view. sequence: what is shown.

    Raises:
        DaemonError: there is a session in it already.
    """

    def __init__(self, path: Path, sequence: FrameSequence) -> None:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise DaemonError(f"{path}: is there already; name another folder for this session")
        self.path, self.views = path, 0
        self._sequence = sequence

    def add(self, shots: Shots) -> Path:
        """Write a view; the folder of its images, which is there only once all of them are."""
        if self.views == 0:
            self.path.mkdir(parents=True, exist_ok=True)
            described = {"encoding": shots.encoding, "sequence": self._sequence.as_mapping()}
            write_atomically(self.path / CAPTURE, json.dumps(described, indent=1).encode())
        place = self.path / f"view_{self.views:02d}"
        unfinished = self.path / f".{place.name}"
        unfinished.mkdir(exist_ok=True)
        for number, pair in enumerate(shots.pairs):
            for side, image in zip(("left", "right"), pair, strict=True):
                (unfinished / f"{side}_{number:02d}.png").write_bytes(png(image))
        unfinished.rename(place)
        self.views += 1
        return place


def png(image: Pixels) -> bytes:
    """A PNG file of a raw image: grey (H, W) or red, green, blue (H, W, 3), 8 or 16 bits."""
    ordered = image[..., ::-1] if image.ndim == 3 else image
    done, data = cv2.imencode(".png", np.ascontiguousarray(ordered), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise DaemonError(f"an image of {image.shape} {image.dtype} cannot be written as PNG")
    return bytes(data)
