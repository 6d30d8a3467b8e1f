"""Points at the borders of surfaces: probably wrong ones are rejected, the others get the sigma of their error."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from pipeline.common.parallel_for import blocks
from pipeline.filter.border.border_figures import Planes, border_figures
from pipeline.filter.border.border_model import FIGURES, MODEL, BorderModel
from pipeline.filter.border.border_pixels import ROWS, border_of_row, changes_of_row
from pipeline.filter.border.border_test import (
    CODES,
    EXPECTED_WRONG,
    LEAST_LIMIT,
    border_test,
    code_of,
    largest_code,
)
from pipeline.filter.texture_agreement import LOSS
from pipeline.match.match_result import PIXEL_STEPS, RESIDUAL_STEP

SHAPE = (60, 90)
PER_ORDER = np.float32(5e-6)
ORDER_MM = 1000.0**2 * float(PER_ORDER)
EDGE, GAP = 45, 2


def planes(seed: int = 3, *, behind_mm: float = 60.0) -> Planes:
    """Two planes 1 m away, the first up to column EDGE, the second ``behind_mm`` farther after a gap; all agrees."""
    rng = np.random.default_rng(seed)
    i, j = np.indices(SHAPE)
    label = np.where(j < EDGE, 1, np.where(j < EDGE + GAP, 0, 2)).astype(np.uint16)
    xyz = np.zeros((*SHAPE, 3), np.float32)
    xyz[..., 2] = 1000 + 0.05 * j + 0.02 * i + behind_mm * (j >= EDGE) + rng.normal(0, 0.02, SHAPE)
    return Planes(
        label, rng.integers(0, 20, SHAPE).astype(np.uint8), np.zeros(SHAPE, np.uint8),
        (PIXEL_STEPS * (j + 20.0)).astype(np.uint16), *rng.normal(0, 4, (2, *SHAPE)).astype(np.int16),
        rng.integers(100, 105, SHAPE).astype(np.uint8), xyz, np.full(SHAPE, 0.02, np.float32),
    )  # fmt: skip


def _tested(p: Planes, model: BorderModel = MODEL, per_order: np.float32 = PER_ORDER) -> tuple[Any, Any, Any, Any]:
    """Codes and expected wrong points by code, misfit and sigma after the test."""
    valid, misfit, sigma = (p.label > 0).astype(np.uint8), p.misfit.copy(), p.sigma.copy()
    p = p._replace(misfit=misfit, sigma=sigma)
    bands = blocks(SHAPE[0], ROWS)
    code, expected = np.full(SHAPE, 99, np.uint8), np.full((bands, CODES), np.nan)
    border_test(
        bands, p, LOSS.astype(np.float32), 1, per_order, model, valid, misfit, sigma, code, expected,
    )  # fmt: skip
    return code, expected, misfit, sigma


def _outcome(
    p: Planes, probability: float = 0.08, model: BorderModel = MODEL, per_order: np.float32 = PER_ORDER
) -> tuple[Any, Any, Any]:
    """Validity with this limit of the probability, misfit and sigma after the test."""
    code, _, misfit, sigma = _tested(p, model, per_order)
    return ((p.label > 0) & (code <= code_of(probability))).astype(np.uint8), misfit, sigma


def _doubtful() -> Planes:
    """Planes some of whose border points are probably wrong."""
    p = planes()
    p.xyz[::3, EDGE - 1, 2] += 0.3 * ORDER_MM
    p.residual_normalised[::3, EDGE - 1] = round(0.3 / RESIDUAL_STEP)
    return p


def test_only_points_near_a_border_are_touched() -> None:
    p = planes()
    valid, _, sigma = _outcome(p)
    from_gap = np.abs(np.arange(SHAPE[1]) - EDGE - 0.5 * (GAP - 1)) - 0.5 * GAP
    far, near = from_gap > 3, (from_gap > 0) & (from_gap < 2)
    assert valid[:, far].all() and (sigma[:, far] == p.sigma[:, far]).all()
    assert valid[4:-4, near].mean() > 0.97 and (sigma[4:-4, near] > p.sigma[4:-4, near]).any()
    assert (sigma >= p.sigma).all()


def test_points_directly_beside_another_surface_are_doubted_more() -> None:
    """Without pixels between them the border of one of both is often displaced: most wrong points lie there."""
    apart, joined = planes(), planes()
    joined.label[:, EDGE : EDGE + GAP] = 1
    beside = [_outcome(p, 0.02)[0][4:-4, EDGE + GAP].mean() for p in (apart, joined)]
    assert beside[1] < beside[0]


def test_a_point_between_two_surfaces_is_rejected_or_gets_a_sigma_of_the_size_of_its_error() -> None:
    clean, p = planes(), planes()
    wrong = np.s_[10:50:4, EDGE - 1]
    p.xyz[wrong][..., 2] += 0.4 * ORDER_MM
    p.residual_normalised[wrong] = round(0.4 / RESIDUAL_STEP)
    p.residual[wrong] = round(0.4 / RESIDUAL_STEP)
    p.mean[wrong], p.deviation[wrong] = 80, 70
    valid, _, sigma = _outcome(p)
    before = _outcome(clean)[2]
    assert valid[wrong].mean() < 0.2
    kept = valid[wrong] != 0
    assert (sigma[wrong][kept] > 5 * before[wrong][kept]).all()


def test_more_points_stay_with_a_larger_probability_and_all_at_one() -> None:
    p = _doubtful()
    kept = [int(_outcome(p, probability)[0].sum()) for probability in (0.002, 0.05, 0.5, 1.0)]
    assert kept == sorted(kept) and kept[0] < kept[-1] == np.count_nonzero(p.label)


def test_the_limit_is_the_largest_with_few_expected_wrong_points() -> None:
    code, expected, _, _ = _tested(_doubtful())
    by_code = expected.sum(axis=0)
    assert by_code[0] == 0 and (by_code[1:] > 0).sum() == len(np.unique(code[code > 0]))
    for points in (10, 3000, 10**5, 10**7):
        most = largest_code(expected, points, code_of(0.5))
        assert code_of(LEAST_LIMIT) <= most <= code_of(0.5)
        if most > code_of(LEAST_LIMIT):
            assert by_code[: most + 1].sum() <= EXPECTED_WRONG * points
        if most < code_of(0.5):
            assert by_code[: most + 2].sum() > EXPECTED_WRONG * points
    assert largest_code(expected, 10, code_of(LEAST_LIMIT)) < largest_code(expected, 10**7, code_of(0.5))


def test_all_points_stay_where_the_test_is_off() -> None:
    assert largest_code(np.full((3, CODES), 1e6), 10, code_of(1.0)) == CODES - 1


def test_the_deviation_from_the_plane_widens_sigma() -> None:
    clean, p = planes(), planes()
    some = np.s_[10:50:4, EDGE - 1]
    p.xyz[some][..., 2] += 0.05 * ORDER_MM
    valid, _, sigma = _outcome(p)
    both = valid[some] != 0
    assert both.any()
    assert (sigma[some][both] > 1.5 * _outcome(clean)[2][some][both]).mean() > 0.8


@pytest.mark.long
def test_the_figures_that_the_model_is_fitted_to_are_those_that_decide() -> None:
    p = planes()
    p.xyz[::3, EDGE - 1, 2] += 0.3 * ORDER_MM
    p.misfit[:] = 9
    found = np.empty((*SHAPE, FIGURES), np.float32)
    border_figures(blocks(SHAPE[0], ROWS), p, LOSS.astype(np.float32), 1, PER_ORDER, found)
    tested = np.isfinite(found).all(-1)
    assert (tested == np.isfinite(found).any(-1)).all() and (tested == (_outcome(p, 1.0)[1] == 0)).all()
    x = (found[tested].astype(np.float64) - MODEL.mean) * MODEL.scale
    row, column = np.tril_indices(FIGURES)
    odds = MODEL.wrong[0] + x @ MODEL.wrong[1 : 1 + FIGURES] + (x[:, row] * x[:, column]) @ MODEL.wrong[1 + FIGURES :]
    code, expected, _, _ = _tested(p)
    assert ((code > 0) == tested).all()
    some = (odds > -5.9) & (odds < 1.8)
    assert some.any() and (np.abs(odds[some] - (code[tested][some] - 0.5) / 16 + 6) < 0.5 / 16 + 1e-3).all()
    assert expected.sum() == pytest.approx((1 / (1 + np.exp(-odds))).sum(), rel=1e-3)


@pytest.mark.parametrize(("variance", "factor"), [(0.25, 1.0), (1.0, 1.0), (4.0, 2.0), (25.0, 5.0)])
def test_sigma_grows_with_the_root_of_the_variance_and_never_shrinks(variance: float, factor: float) -> None:
    spread = np.zeros_like(MODEL.spread)
    spread[0] = np.log(variance)
    p = planes()
    p.misfit[:] = 9
    _, misfit, sigma = _outcome(p, 1.0, MODEL._replace(spread=spread))
    tested = misfit == 0
    assert tested[4:-4, EDGE - 2 : EDGE].all() and tested[4:-4, EDGE + GAP].all() and not tested[:, : EDGE - 4].any()
    assert np.allclose(sigma[tested], factor * p.sigma[tested], rtol=1e-5)


def test_the_outcome_depends_neither_on_the_unit_nor_on_what_unknown_pixels_hold() -> None:
    p = planes()
    p.label[20:30, 60:70] = 0
    wrong = np.s_[30:50:4, EDGE - 1]
    p.xyz[wrong][..., 2] += 0.4 * ORDER_MM
    p.mean[wrong], p.deviation[wrong] = 80, 70
    valid, misfit, sigma = _outcome(p)
    unknown = p.label == 0
    p.xyz[unknown], p.residual[unknown], p.deviation[unknown] = np.nan, 30000, 255
    metres = p._replace(xyz=p.xyz / np.float32(1000), sigma=p.sigma / np.float32(1000))
    in_metres = _outcome(metres, per_order=np.float32(1000) * PER_ORDER)
    assert (valid == in_metres[0]).all() and (misfit[~unknown] == in_metres[1][~unknown]).all()
    assert (sigma > p.sigma).any() and not valid[~unknown].all()
    assert np.allclose(sigma[~unknown], 1000 * in_metres[2][~unknown], rtol=0.01)


def test_a_border_that_is_near_in_the_right_image_only_counts_too() -> None:
    label = np.ones((5, 40), np.uint16)
    label[:, 20:] = 2
    even, steep = (np.zeros((5, 40), np.uint16) for _ in range(2))
    even[:], steep[:] = PIXEL_STEPS * (np.arange(40) + 9), PIXEL_STEPS * (np.arange(40) // 4 + 9)
    near = [np.empty(40, np.uint8) for _ in range(2)]
    changes = np.zeros((2, 5, 40), np.uint8)
    for i in range(5):
        changes_of_row(label, i, *changes[:, i])
    border_of_row(label, even, 2, *changes, near[0])
    border_of_row(label, steep, 2, *changes, near[1])
    assert np.flatnonzero(near[0]).tolist() == [18, 19, 20, 21]
    assert set(np.flatnonzero(near[0])) < set(np.flatnonzero(near[1])) and near[1].sum() > 7


@pytest.mark.threads
def test_the_test_does_not_depend_on_the_number_of_threads() -> None:
    most = numba.get_num_threads()
    results = []
    try:
        for threads in (1, most):
            numba.set_num_threads(threads)
            results.append(_tested(planes()))
    finally:
        numba.set_num_threads(most)
    assert all((a == b).all() for a, b in zip(*results, strict=True))
