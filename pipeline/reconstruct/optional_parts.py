"""Parts of a cloud that are computed only on demand: colour and normals."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, Protocol

from pipeline.attributes.normals import normals_of
from pipeline.common.stopwatch import Stopwatch
from pipeline.reconstruct.cloud import Cloud

RGB, NORMALS = "rgb", "normals"


class HasColor(Protocol):
    """The reconstructor of a single shot, or of sets."""

    def color(self, left: Any, /) -> Any:
        """The fringe-free colour of the left raw image, or of a set's left images, (H, W, 3) uint8."""


def with_parts(
    cloud: Cloud, reconstructor: HasColor, left: Any, parts: Collection[str], *, stride: int = 1,
    clock: Callable[[], int] | None = None,
) -> Cloud:  # fmt: skip
    """The cloud with those of the parts ``rgb`` and ``normals`` that are named; others are no matter of this function.

    Args:
        cloud: of ``left``, the left raw image or a set's left images, made by ``reconstructor`` with ``stride``; its
            grid is dense again if it was downsampled.
        clock: returns nanoseconds; adds the stages ``color`` and ``normals`` to the cloud's ``ms``.
    """
    watch = Stopwatch(clock)
    if RGB in parts:
        cloud = replace(cloud, rgb=reconstructor.color(left))
        watch.lap("color")
    if NORMALS in parts:
        downsampled = cloud.grid is not None and cloud.grid.gray.shape != cloud.gray.shape
        normals = normals_of(cloud.xyz, cloud.sigma_mm, stride=1 if downsampled else stride)
        cloud = replace(cloud, normals=normals)
        watch.lap("normals")
    return replace(cloud, ms=cloud.ms | watch.ms) if watch.ms else cloud
