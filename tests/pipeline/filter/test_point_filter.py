"""The gates agree with plain definitions on small images, whatever the number of threads."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.common.parallel_for import blocks
from pipeline.common.settings import Settings
from pipeline.decode.decoder import PhaseMap
from pipeline.filter.local_outliers import RADIUS, ROWS, drop_mixed_edges, local_outliers, usual_residuals
from pipeline.filter.occlusion.occlusion_conflicts import PARAMETER_STEPS, Values
from pipeline.filter.occlusion.uniqueness import Uniqueness
from pipeline.filter.point_filter import Gates
from pipeline.filter.surfaces import surface_links
from pipeline.filter.texture_agreement import Agreement, Scale
from pipeline.fringe_order.margins.sampled_groups import Ambiguous
from pipeline.geometry.ray_tables import DepthScale
from pipeline.match.match_result import LARGEST_RESIDUAL, OUTSIDE, PIXEL_STEPS, TURN_STEPS, MatchResult, Points

SHAPES = [(1, 1), (5, 7), (40, 33), (70, 90)]


def _blobs(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Any:
    """An image of 0 and 1 with areas and single pixels."""
    coarse = rng.random((shape[0] // 6 + 1, shape[1] // 6 + 1)) < share
    fine = np.kron(coarse, np.ones((6, 6), bool))[: shape[0], : shape[1]]
    return (fine ^ (rng.random(shape) < 0.03)).astype(np.uint8)


@pytest.mark.parametrize("shape", SHAPES)
def test_local_outliers_are_those_of_the_definition(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    valid = _blobs(rng, shape, 0.7)
    residuals = rng.normal(0, 120, (2, *shape)).clip(-LARGEST_RESIDUAL, LARGEST_RESIDUAL).astype(np.int16)
    residuals[:, rng.random(shape) < 0.05] = LARGEST_RESIDUAL
    residuals[:, valid == 0] = rng.integers(-32768, 32767, (2, int((valid == 0).sum())))
    limit, largest, mean = 80, 200, 12
    expected = np.zeros(shape, np.uint8)
    for i, j in zip(*np.nonzero(valid), strict=True):
        window = np.s_[max(0, i - RADIUS) : i + RADIUS + 1, max(0, j - RADIUS) : j + RADIUS + 1]
        some = valid[window] > 0
        means = [r[window][some].mean() for r in residuals]
        near = any(abs(r[i, j] - m) < limit for r, m in zip(residuals, means, strict=True))
        small = (abs(residuals[:, i, j]) <= largest).any() and min(abs(m) for m in means) <= mean
        expected[i, j] = near and small and some.mean() >= 0.25
    out = np.full(shape, 9, np.uint8)
    local_outliers(blocks(len(valid), ROWS), valid, *residuals, limit, largest, mean, out)
    np.testing.assert_array_equal(out, expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_usual_residuals_are_medians_over_the_neighbourhoods_without_an_unknown_pixel(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    match = MatchResult.empty(shape)
    match.valid[:] = 1 if min(shape) < 9 else _blobs(rng, shape, 0.95)
    match.residual[:], match.residual_normalised[:] = rng.normal(30, 60, (2, *shape)).astype(np.int16)
    windows = np.lib.stride_tricks.sliding_window_view
    size = (min(2 * RADIUS + 1, shape[0]), min(2 * RADIUS + 1, shape[1]))
    every = max(1, round((match.valid.size / 800) ** 0.5))  # about 800 of them
    known = (windows(match.valid, size).all(axis=(2, 3)) & (min(size) == 2 * RADIUS + 1))[::every, ::every]
    a, b = (windows(r.astype(float), size)[::every, ::every] for r in (match.residual, match.residual_normalised))
    means = np.minimum(abs(a.mean(axis=(2, 3))), abs(b.mean(axis=(2, 3))))[known]
    squares = np.minimum(a**2, b**2).mean(axis=(2, 3))[known]
    expected = (int(np.median(means)), int(np.median(squares))) if known.any() else (0, 0)
    assert usual_residuals(match) == pytest.approx(expected, abs=1)


@pytest.mark.parametrize("shape", SHAPES)
def test_only_weak_pixels_at_a_surfaces_border_are_mixed(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    label = np.kron(rng.integers(0, 4, (shape[0] // 5 + 1, shape[1] // 5 + 1)), np.ones((5, 5), int))
    label = label[: shape[0], : shape[1]].astype(np.uint16)
    modulation = rng.integers(0, 256, shape).astype(np.uint8)
    share = np.float32(0.65)
    expected = (label > 0).astype(np.uint8)
    framed = np.pad(label, 1)
    for i, j in zip(*np.nonzero(label), strict=True):
        border = (framed[i : i + 3, j : j + 3] != label[i, j]).any()
        window = np.s_[max(0, i - 1) : i + 2, max(0, j - 1) : j + 2]
        best = modulation[window][label[window] == label[i, j]].max()
        expected[i, j] = not (border and np.float32(modulation[i, j]) < share * np.float32(best))
    out = np.full(shape, 9, np.uint8)
    drop_mixed_edges(blocks(len(label), ROWS), label, modulation, share, out)
    np.testing.assert_array_equal(out, expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_surfaces_are_the_connected_ones(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    valid = _blobs(rng, shape, 0.6)
    link = rng.choice(np.uint8([0, 1, 2, 3]), shape, p=[0.1, 0.1, 0.1, 0.7])
    surfaces, label = Surfaces(shape), np.full(shape, 9, np.uint16)
    number = surfaces.find(valid, link, 4)
    surfaces.paint(label)
    expected = _connected(valid, link)
    names, sizes = np.unique(expected[expected > 0], return_counts=True)
    large = {int(n): int(s) for n, s in zip(names, sizes, strict=True) if s >= 4}
    assert number == len(large) and sorted(surfaces.sizes) == sorted(large.values())
    np.testing.assert_array_equal(label > 0, np.isin(expected, list(large)))
    for name, size in large.items():
        (painted,) = np.unique(label[expected == name])
        assert surfaces.sizes[painted - 1] == size == (label == painted).sum()


def _connected(valid: Any, link: Any) -> Any:
    """Number of the connected component of each valid pixel, from 1 on."""
    out = np.where(valid, np.arange(1, valid.size + 1).reshape(valid.shape), 0)
    beside = (valid[:, 1:] & valid[:, :-1] & link[:, 1:]) > 0
    below = (valid[1:] & valid[:-1] & (link[1:] >> 1)) > 0
    while True:
        before = out.copy()
        for a, b, joined in ((out[:, 1:], out[:, :-1], beside), (out[1:], out[:-1], below)):
            least = np.minimum(a, b)
            np.copyto(a, least, where=joined)
            np.copyto(b, np.minimum(a, b), where=joined)
        if (out == before).all():
            return out


def test_links_follow_the_expected_steps_and_the_phase_may_wrap_around() -> None:
    absolute_phase = (32767 + 24 * np.arange(-5, 5)).astype(np.int16)[None].repeat(2, 0)
    u = (PIXEL_STEPS * np.arange(20, 30)).astype(np.int16)[None].repeat(2, 0)
    v = (PIXEL_STEPS * np.array([[5], [6]])).astype(np.int16).repeat(10, 1)
    absolute_phase[:, 7:] += TURN_STEPS
    u[1, :] += 2 * PIXEL_STEPS
    out = np.full((2, 10), 9, np.uint8)
    surface_links.links(len(u), absolute_phase, u, v, 24, 0, out)
    assert (out[0, 1:] == LEFT).tolist() == [True] * 6 + [False] + [True] * 2
    assert not (out[1] & UP).any()


@pytest.mark.parametrize(("by_depth", "seed"), [(False, 4), (True, 5), (False, 6)])
def test_of_two_claims_to_one_pixel_the_one_of_the_definition_stays(by_depth: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape, device = (70, 90), (50, 37)
    label = np.kron(rng.integers(0, 5, (6, 6)), np.ones((12, 15), int))[: shape[0], : shape[1]].astype(np.uint16)
    valid = ((label > 0) & (rng.random(shape) < 0.9)).astype(np.uint8)
    i, j = np.indices(shape)
    u = (PIXEL_STEPS * (j * 0.7 - 4 * label + 2) + rng.integers(0, 12, shape)).clip(0, OUTSIDE).astype(np.uint16)
    v = (PIXEL_STEPS * (i * 0.6 + label)).astype(np.uint16)
    u[:, :3] = OUTSIDE
    depth = Points.empty(shape).depth_mm(1)
    depth[:] = 800 + 0.01 * rng.permutation(label.size).reshape(shape)
    phase = rng.integers(-32768, 32767, shape).astype(np.int16) // 64 * 64
    base, span = np.float32(1 / 900), np.float32(1 / 700 - 1 / 900)
    size = np.bincount(label[label > 0] - 1, minlength=4).astype(np.int32)
    tolerance, sure = (PARAMETER_STEPS // 200, 700) if by_depth else (61, 700)
    value = ((1 / depth - base) / span * PARAMETER_STEPS).astype(np.int16) if by_depth else phase
    expected = _unique(valid, label, u // PIXEL_STEPS, v // PIXEL_STEPS, depth, value, device, size, tolerance, sure)
    assert 0 < (expected != valid).sum() < valid.sum()
    Uniqueness(shape, (device,)).apply(
        valid, label, size, u, v, depth, device, Values(phase, by_depth, base, span), tolerance, sure
    )
    np.testing.assert_array_equal(valid, expected)


def _unique(
    valid: Any, label: Any, x: Any, y: Any, depth: Any, value: Any, device: tuple[int, int], size: Any, tolerance: int,
    sure: int,
) -> Any:  # fmt: skip
    places: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for p in zip(*np.nonzero(valid), strict=True):
        if x[p] < device[0] and y[p] < device[1]:
            places.setdefault((int(x[p]), int(y[p])), []).append(p)
    conflicts: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for claimants in places.values():
        ends = {min(claimants, key=lambda p: depth[p]), max(claimants, key=lambda p: depth[p])}
        for p in claimants:
            found = [q for q in ends if label[q] != label[p]]
            found = [q for q in found if abs((int(value[p]) - int(value[q]) + 32768) % 65536 - 32768) > tolerance]
            if found:
                conflicts[p] = found
    share = np.zeros(len(size))
    for p in conflicts:
        share[label[p] - 1] += 1 / size[label[p] - 1]

    def keeps_pixel(p: tuple[int, int], q: tuple[int, int]) -> bool:
        a, b = label[p] - 1, label[q] - 1
        if max(share[a], share[b]) > 0.4 and abs(share[a] - share[b]) > 0.25:
            return bool(share[a] < share[b])
        if size[a] >= sure and size[b] >= sure:
            return bool(depth[p] < depth[q])
        return bool(size[a] > size[b])

    out = valid.copy()
    for p, found in conflicts.items():
        out[p] = all(keeps_pixel(p, q) for q in found)
    return out


@pytest.mark.threads
def test_what_is_certain_does_not_depend_on_the_number_of_threads_nor_on_the_unknown() -> None:
    rng = np.random.default_rng(7)
    shape, right, projector = (150, 200), (210, 150), (160, 120)
    i, j = np.indices(shape)
    area = (j // 50 + i // 75) % 3
    valid = _blobs(rng, shape, 0.9)

    def steps(x: Any) -> Any:
        return (PIXEL_STEPS * x).clip(0, OUTSIDE).astype(np.uint16)

    match = MatchResult(
        valid, steps(j + 25.0 * area), steps(i + 0.5), steps(0.7 * j + 20 * area), steps(0.7 * i),
        (24 * j + 2000 * area).astype(np.int16), *rng.normal(0, 30, (2, *shape)).astype(np.int16),
    )  # fmt: skip
    points = Points.empty(shape)
    depth = points.depth_mm(1)
    depth[:] = 800 + 30 * area + 0.1 * j
    modulation = rng.integers(40, 90, shape).astype(np.uint8)
    blank = np.zeros(shape, np.int32)
    left = PhaseMap(
        blank, blank, modulation, np.ones(shape, np.float32), 0.0, rng.uniform(-3, 3, shape).astype(np.float32),
        modulation, np.ones(shape, bool), modulation,
    )  # fmt: skip
    gates = Gates(
        shape, right, projector, (24 * 2 * np.pi / TURN_STEPS, 0.0), DepthScale(1 / 900, 1 / 700 - 1 / 900), 0.1,
        Settings(), smallest=50,
    )  # fmt: skip
    deviation = rng.integers(0, 40, shape).astype(np.uint8)
    scale = Scale(0.0, 0.01, 0.0, 0.02, 0.3, 2.4)
    most = numba.get_num_threads()
    results = []
    try:
        for threads in sorted({1, most}):
            numba.set_num_threads(threads)
            for _ in range(2):
                for plane in (depth, *match[1:]):
                    filling: Any = [np.nan, np.inf, 0] if plane.dtype.kind == "f" else [0, 65535, 7]
                    plane[valid == 0] = rng.choice(np.array(filling).astype(plane.dtype), int((valid == 0).sum()))
                agreement = Agreement(deviation.copy(), np.zeros(shape, np.uint8))
                points.sigma_mm[:] = 0.02
                results.append(gates.certain(match, points, left, agreement, scale).copy())
    finally:
        numba.set_num_threads(most)
    assert all((r == results[0]).all() for r in results)
    assert 0.2 < results[0].mean() < valid.mean() and not results[0][valid == 0].any()


@pytest.mark.parametrize(("kept", "walls"), [(0.9, True), (0.003, False)])
def test_large_parts_between_edges_are_judged_alone_where_much_of_a_surface_is_ambiguous(
    kept: float, walls: bool
) -> None:
    """A bright object beside a dark wall, both of one surface, whose orders may be those of the object."""
    shape, right, projector = (150, 200), (210, 150), (160, 120)
    i, j = np.indices(shape)
    steps = [(PIXEL_STEPS * x).clip(0, OUTSIDE).astype(np.uint16) for x in (j + 5.0, i + 0.5, 0.7 * j, 0.7 * i)]
    zeros = np.zeros(shape, np.int16)
    match = MatchResult(np.ones(shape, np.uint8), *steps, (24 * j).astype(np.int16), zeros, zeros.copy())
    points = Points.empty(shape)
    points.depth_mm(1)[:], points.sigma_mm[:] = 800 + 0.1 * j, 0.02
    mean = np.where(j < 120, 150, 40).astype(np.uint8)
    blank, phase = np.zeros(shape, np.int32), (24 * j * 2 * np.pi / TURN_STEPS).astype(np.float32)
    left = PhaseMap(
        blank, blank, mean, np.ones(shape, np.float32), 0.0, phase, mean, np.ones(shape, bool), mean
    )  # fmt: skip
    gates = Gates(
        shape, right, projector, (24 * 2 * np.pi / TURN_STEPS, 0.0), DepthScale(1 / 900, 1 / 700 - 1 / 900), 0.1,
        Settings(), smallest=20,
    )  # fmt: skip
    judged = []

    def reject_ambiguous(label: Any, sizes: Any, continued: Any, valid: Any) -> Ambiguous:
        assert len(continued.change) == len(sizes)
        judged.append([np.flatnonzero((label == k + 1).any(axis=0)) for k in range(len(sizes))])
        if len(judged) > 1:
            valid[(label > 0) & (label == label[75, 195])] = 0
        return Ambiguous(0.0, kept)

    agreement = Agreement(np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))
    certain = gates.certain(match, points, left, agreement, Scale(0.0, 0.01, 0.0, 0.02, 0.3, 2.4), reject_ambiguous)
    assert len(judged[0]) == 1
    assert len(judged) == (2 if walls else 1)
    if walls:
        sides = [part for part in judged[1] if part.max() < 120 or part.min() > 120]
        assert [(part.min() < 60, part.max() > 180) for part in sides] == [(True, False), (False, True)]
    assert certain[:, 5:100].all()
    assert certain[:, 130:195].all() != walls and certain[:, 130:195].any() != walls
