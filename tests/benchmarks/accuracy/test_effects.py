"""Effects on the light, the counts and the images of both cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy.effects import COUNTS, IMAGES, INTERPOLATED, LIGHT, TOGETHER, displaced, errors_of, with_effect
from benchmarks.reconstruction.cases import HARD

CASE = HARD[0]
BAYER = next(case for case in HARD if case.encoding == "bayer_rggb8")
LIGHTS = tuple(np.random.default_rng(n).uniform(20, 120, (64, 96, 3)).astype(np.float32) for n in (0, 1))


EFFECTS = [name for name in (*LIGHT, *COUNTS, *IMAGES) if name != "none"]


@pytest.mark.parametrize(
    ("name", "case"),
    [(name, case) for name in EFFECTS for case in (CASE, BAYER) if case is CASE or name != INTERPOLATED],
    ids=lambda value: getattr(value, "name", value),
)
def test_every_effect_changes_what_it_names_and_nothing_twice_differently(name: str, case: object) -> None:
    before, after = with_effect("none", LIGHTS, case), with_effect(name, LIGHTS, case)
    assert [image.shape for image in after] == [image.shape for image in before]
    left, right = (bool((a != b).any()) for a, b in zip(before, after, strict=True))
    assert right == (not name.startswith("left"))
    assert left == (not name.startswith("right"))
    for image, again in zip(after, with_effect(name, LIGHTS, case), strict=True):
        np.testing.assert_array_equal(image, again)


def test_a_displacement_moves_an_image_by_its_pixels() -> None:
    ramp = np.tile(np.arange(96, dtype=np.float32)[:, None], (64, 1, 3))
    np.testing.assert_allclose(displaced(ramp, 0.25, 0)[20:40, 20:60], ramp[20:40, 20:60] - 0.25, atol=0.05)
    turned = np.ascontiguousarray(ramp.swapaxes(0, 1))
    np.testing.assert_allclose(displaced(turned, 0, 0.25)[20:60, 20:40], turned[20:60, 20:40] - 0.25, atol=0.05)


def test_white_balance_multiplies_the_right_cameras_channels() -> None:
    case = replace(CASE, optics=replace(CASE.optics, noise=0.0, black_dn=0.0, crosstalk=0.0))
    name = next(iter(COUNTS))
    before, after = with_effect("none", LIGHTS, case)[1], with_effect(name, LIGHTS, case)[1]
    ratio = after.reshape(-1, 3).mean(axis=0) / before.reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(ratio, [1.25, 1.0, 0.8], rtol=0.02)


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("case", "wrong", "false_points"),
    [("plaster cast, realistic Bayer", 0.003, 0), ("wall that one camera sees, far", 0.02, 1000)],
)
def test_ordinary_faults_together_leave_few_wrong_points(case: str, wrong: float, false_points: int) -> None:
    """Without decisions 64 and 65 no point of the cast is right, and 30 % of the wall's points are wrong."""
    ((_, found, verdict),) = errors_of(next(each for each in HARD if each.name == case), [TOGETHER])
    assert verdict != "inconsistent"
    assert found.covered > 0.9 and found.wrong < wrong and found.false_points <= false_points
