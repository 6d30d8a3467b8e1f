"""The images of every accepted view on disk, for solving without the hardware."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from daemon.apps.calibration.guided.capture import CapturedImages
from daemon.common.errors import DaemonError
from daemon.common.files import write_atomically
from daemon.recording.format.raw_image import Pixels
from pipeline.pattern.sequence import FrameSequence

CAPTURE = "capture.json"


class SessionFolder:
    """A capture folder to which views are added.

    Args:
        path: of a new or empty folder, created with the first view. sequence: of the captures.

    Raises:
        DaemonError: the folder contains files.
    """

    def __init__(self, path: Path, sequence: FrameSequence) -> None:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise DaemonError(f"{path} exists already; name another folder for this session")
        self.path, self.views = path, 0
        self._sequence = sequence

    def add(self, captured: CapturedImages) -> Path:
        """Write a view and return the folder of its images, which appears when it is complete."""
        if self.views == 0:
            self.path.mkdir(parents=True, exist_ok=True)
            description = {
                "encoding": captured.encoding,
                "serials": dict(captured.serials),
                "sequence": self._sequence.as_mapping(),
            }
            write_atomically(self.path / CAPTURE, json.dumps(description, indent=1).encode())
        folder = self.path / f"view_{self.views:02d}"
        unfinished = self.path / f".{folder.name}"
        unfinished.mkdir(exist_ok=True)
        for number, pair in enumerate(captured.pairs):
            for side, image in zip(("left", "right"), pair, strict=True):
                (unfinished / f"{side}_{number:02d}.png").write_bytes(png(image))
        unfinished.rename(folder)
        self.views += 1
        return folder


def png(image: Pixels) -> bytes:
    """Encode a raw image as PNG: grey (H, W) or red, green, blue (H, W, 3), 8 or 16 bits."""
    ordered = image[..., ::-1] if image.ndim == 3 else image
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(ordered), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not encoded:
        raise DaemonError(f"an image of {image.shape} {image.dtype} cannot be written as PNG")
    return bytes(data)
