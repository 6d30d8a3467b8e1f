"""Fringes that the cameras see or do not see, on rendered images."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from daemon.config.sections.health import HealthLimits
from daemon.live.items import CloudItem
from daemon.monitoring.health.observe.illumination import Illumination
from daemon.monitoring.health.rules import RULES
from drivers.protocols import Frame
from pipeline.reconstruct.reconstructor import Reconstructor
from tests.pipeline.small import images, pair, reconstructor


@pytest.fixture(scope="module")
def small() -> Reconstructor:
    made: Reconstructor = reconstructor()
    return made


def values(small: Reconstructor, left: Any, right: Any) -> dict[str, float]:
    cloud = small.reconstruct(left, right)
    frames = (Frame(side, 1, 0, 0, "rgb8", image) for side, image in (("left", left), ("right", right)))
    return Illumination(small.calibration, small.pattern).values(CloudItem(1, 0, cloud, *frames, latency_ms=1.0))


def broken(found: dict[str, float]) -> set[str]:
    """The rules of light whose limit is not kept, as by default."""
    rules = [rule for rule in RULES if rule.name in ("least_lit_share", "least_lit_coverage")]
    return {rule.name for rule in rules if rule.worst(found)[1] < (rule.limit(HealthLimits()) or 0.0)}


def frozen(image: Any) -> Any:
    image = np.clip(image, 0, 255).astype(np.uint8)
    image.setflags(write=False)
    return image


def patch_of(image: Any) -> Any:
    """The image, dark but for 30 x 30 pixels in the middle."""
    middle = tuple(slice(size // 2 - 15, size // 2 + 15) for size in image.shape[:2])
    dark = np.full_like(image, 2)
    dark[middle] = image[middle]
    return frozen(dark)


@pytest.mark.parametrize("scene", ["isolated", "spheres", "moving"])
def test_a_scene_with_fringes_raises_nothing_even_if_few_objects_are_lit(small: Reconstructor, scene: str) -> None:
    left, right = images(pair(scene))
    assert not broken(values(small, left, right))
    assert "least_lit_share" not in broken(values(small, patch_of(left), patch_of(right)))


def test_a_covered_lens_or_a_projector_without_light_is_no_fringes(small: Reconstructor) -> None:
    left, _ = images(pair("spheres"))
    dark = frozen(np.random.default_rng(0).normal(3, 1.5, left.shape))
    assert "least_lit_share" in broken(values(small, dark, dark))
    assert "least_lit_share" in broken(values(small, left, dark))


def test_a_scene_in_coloured_room_light_is_lit_but_gives_no_points(small: Reconstructor) -> None:
    rng, lit = np.random.default_rng(0), []
    for image in images(pair("spheres")):
        room = cv2.GaussianBlur(image.max(axis=2).astype(np.float32), (0, 0), 3)[..., None] * [1.0, 0.8, 0.6]
        lit.append(frozen(room + rng.normal(0, 1.5, image.shape)))
    assert broken(values(small, *lit)) == {"least_lit_coverage"}
