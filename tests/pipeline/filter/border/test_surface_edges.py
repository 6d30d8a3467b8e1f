"""Pixels at the edge of a surface."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import blocks
from pipeline.filter.border.surface_edges import ROWS, edge_test
from pipeline.filter.point_filter import EDGE_LOSS, HIGH, LOSS_PER_NEIGHBOUR, MISFIT_OF
from pipeline.filter.texture_agreement import LOSS


def _tested(label: Any, deviation: Any) -> tuple[Any, Any]:
    valid, misfit = (label > 0).astype(np.uint8), np.zeros(label.shape, np.uint8)
    edge_test(
        blocks(len(label), ROWS), label, deviation, LOSS.astype(np.float32), HIGH, np.float32(EDGE_LOSS),
        np.float32(LOSS_PER_NEIGHBOUR), MISFIT_OF, misfit, valid,
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
