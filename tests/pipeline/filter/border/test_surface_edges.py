"""Pixels at the edge of a surface."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import blocks
from pipeline.filter.border.surface_edges import ROWS, edge_test
from pipeline.filter.point_filter import EDGE_LOSS, HIGH, LOSS_PER_NEIGHBOUR, MISFIT_OF
from pipeline.filter.texture_agreement import LOSS


def _tested(label: Any, deviation: Any, residuals: Any = None, calm: int = 0) -> tuple[Any, Any]:
    valid, misfit = (label > 0).astype(np.uint8), np.zeros(label.shape, np.uint8)
    first, second = np.zeros((2, *label.shape), np.int16) if residuals is None else residuals
    edge_test(
        blocks(len(label), ROWS), label, deviation, LOSS.astype(np.float32), HIGH, np.float32(EDGE_LOSS),
        np.float32(LOSS_PER_NEIGHBOUR), MISFIT_OF, first, second, calm, misfit, valid,
    )  # fmt: skip
    return valid, misfit


def _two_surfaces() -> tuple[Any, Any]:
    label = np.ones((40, 60), np.uint16)
    label[:, 30:] = 2
    return label, np.full(label.shape, 12, np.uint8)


def test_pixels_that_agree_stay_and_only_those_at_edges_get_a_larger_sigma() -> None:
    label, deviation = _two_surfaces()
    valid, misfit = _tested(label, deviation)
    assert valid.all()
    inside = np.ones(label.shape, bool)
    inside[[0, -1], :], inside[:, [0, -1]], inside[:, 29:31] = False, False, False
    assert not misfit[inside].any() and misfit[1:-1, 29:31].all()


def test_a_strip_of_another_surface_at_an_edge_is_rejected() -> None:
    label, deviation = _two_surfaces()
    deviation[:, 30:33] = 250
    valid, _ = _tested(label, deviation)
    assert not valid[:, 30:32].any() and valid[:, :30].all() and valid[:, 34:].all()


def test_a_protruding_pixel_needs_more_agreement_than_one_inside() -> None:
    label = np.zeros((20, 20), np.uint16)
    label[:, :10], label[10, 10] = 1, 1
    deviation = np.full(label.shape, 30, np.uint8)
    deviation[10, 10] = 110
    valid, misfit = _tested(label, deviation)
    assert valid[5, 9] and misfit[10, 10] > misfit[5, 9] > 0


def test_a_highlight_inside_a_surface_stays_where_the_projector_agrees_around_it() -> None:
    label, deviation = _two_surfaces()
    deviation[10:25, 10:20] = 200
    residuals = np.random.default_rng(0).normal(0, 20, (2, *label.shape)).astype(np.int16)
    square = int(np.minimum(residuals[0].astype(int) ** 2, residuals[1].astype(int) ** 2).mean())
    highlight = np.s_[12:23, 12:18]
    assert not _tested(label, deviation, residuals, 0)[0][highlight].any(), (
        "where the projector distinguishes no orders"
    )
    valid, misfit = _tested(label, deviation, residuals, 3 * square)
    assert valid[highlight].all() and (misfit[highlight] >= MISFIT_OF[8]).all()
    assert not _tested(label, deviation, residuals, square // 3)[0][highlight].any()
    worse = residuals.copy()
    worse[0] *= 10
    assert _tested(label, deviation, worse, 4 * square)[0][highlight].all(), "the smaller of both residuals counts"
    worse *= 10
    assert not _tested(label, deviation, worse, 4 * square)[0][highlight].any()


def test_at_the_edge_of_a_surface_the_projector_is_no_evidence() -> None:
    label, deviation = _two_surfaces()
    deviation[:, 30:33] = 250
    valid, _ = _tested(label, deviation, np.zeros((2, *label.shape), np.int16), 100)
    assert not valid[:, 30:32].any()
