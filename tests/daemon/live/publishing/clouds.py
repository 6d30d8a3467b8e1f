"""Small clouds, publishers and waiting for the tests of the stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from daemon.live.items import CloudItem
from daemon.live.publishing.publisher import Publisher
from drivers.protocols import Frame
from pipeline.reconstruct.cloud import Cloud
from pipeline.rig.calibration import Calibration
from tests.pipeline import rigs
from tools.waiting import wait_until

SIZE = (32, 26)
TCP = "tcp://127.0.0.1:*"


def calibration() -> Calibration:
    """A rig whose left camera has 32 x 26 pixels."""
    rig = rigs.rig()
    return Calibration(
        left=rig.left.cropped(100, 80, *SIZE),
        right=rig.right.cropped(100, 80, *SIZE),
        projector=rig.projector,
        left_color=rig.left_color,
        right_color=rig.right_color,
    )


def item(seq: int, *, encoding: str = "rgb8", size: tuple[int, int] = SIZE) -> CloudItem:
    """A tilted plane with a hole, on the rays of the rig if it has the rig's size."""
    width, height = size
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    z = 1400 + 0.37 * u - 0.21 * v + seq
    z[2:5, 3:7] = np.nan
    # Other sizes: a plain grid, the same to the last bit on every machine.
    rays = calibration().left.rays().astype(np.float32) if size == SIZE else np.stack([u, v], -1) / np.float32(1024)
    xyz = np.concatenate([rays * z[..., None], z[..., None]], axis=-1)
    gray = ((u + v) % 256).astype(np.uint8)
    cloud = Cloud(
        xyz, np.where(np.isnan(z), np.nan, 0.05).astype(np.float32), gray, (gray, gray), gray.astype(np.int16)
    )
    frames = [frame(side, seq, encoding, size) for side in ("left", "right")]
    return CloudItem(seq, 1_000_000_000 + seq, cloud, frames[0], frames[1], latency_ms=21.0, dropped=2)


def half(seq: int) -> CloudItem:
    """The same plane, measured at every second row and column."""
    whole = item(seq)
    cloud = whole.cloud
    gray, xyz, sigma = cloud.gray[::2, ::2].copy(), cloud.xyz[::2, ::2].copy(), cloud.sigma_mm[::2, ::2].copy()
    return replace(whole, stride=2, cloud=Cloud(xyz, sigma, gray, (gray, gray), gray.astype(np.int16)))


def frame(side: Any, seq: int, encoding: str, size: tuple[int, int]) -> Frame:
    """A grey image with a clipped patch."""
    shape = (size[1], size[0], 3) if encoding == "rgb8" else (size[1], size[0])
    image = np.full(shape, 90, np.uint16 if encoding == "mono16" else np.uint8)
    image[8:16, 8:16] = np.iinfo(image.dtype).max
    return Frame(side, seq, 0, 0, encoding, image)


@contextmanager
def publisher(endpoint: str = TCP, *, session: str = "session-1", **options: Any) -> Iterator[Publisher]:
    """A publisher that is closed at the end."""
    made = Publisher(
        [endpoint],
        device="rig-t",
        session=session,
        calibration=calibration(),
        calibration_data=b"fringed_calibration: 1\n",
        identity="sha256:00",
        config={"device": {"name": "rig-t"}},
        **options,
    )
    try:
        yield made
    finally:
        made.close()


def sent(made: Publisher, topic: str) -> int:
    """How many messages of a topic went out."""
    return made.status()["sent"].get(topic, 0)


def send(made: Publisher, what: CloudItem, topic: str = "cloud/full") -> None:
    """Offer a cloud and wait until it is out."""
    before = sent(made, topic)
    assert made.offer(what)
    wait_until(lambda: sent(made, topic) > before)
