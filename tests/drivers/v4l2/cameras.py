"""Cameras over the kernel of our own."""

from __future__ import annotations

from typing import Any

from drivers.protocols import CameraInfo
from drivers.v4l2.camera import V4l2Camera
from drivers.v4l2.options import from_mapping
from tests.drivers.v4l2.fake import PATH, FakeKernel

GREY = bytes(range(32)) * 16


def made(kernel: FakeKernel, **options: Any) -> V4l2Camera:
    return V4l2Camera("left", from_mapping("left", {"device": PATH, **options}), kernel=kernel)


def opened(kernel: FakeKernel, **options: Any) -> CameraInfo:
    camera = made(kernel, **options)
    try:
        return camera.open()
    finally:
        camera.close()


def started(kernel: FakeKernel, **options: Any) -> V4l2Camera:
    camera = made(kernel, **options)
    camera.open()
    camera.start()
    return camera


def counted(camera: V4l2Camera) -> dict[str, int]:
    """What was counted, without the zeros."""
    return {name: count for name, count in camera.health().counters.items() if count}
