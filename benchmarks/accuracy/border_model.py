"""Fit of the border test's coefficients to simulated images: ``python -m benchmarks.accuracy.border_model``.

Points at the borders of surfaces of the hard cases, at full and half size, with figures as the pipeline computes them.
Wrong points (by more than 6 mm, or without truth) against right ones: logistic regression. Errors of the others:
regression of the logarithm of the variance, by maximum likelihood of a normal distribution.
``--write`` writes the coefficients into the pipeline's module.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

import pipeline.filter.border.border_model
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import HARD, Case, random_case, scaled
from pipeline.common.settings import Settings
from pipeline.filter import point_filter
from pipeline.filter.border.border_figures import border_figures
from pipeline.filter.border.border_model import FIGURES
from pipeline.reconstruct import orders_to_cloud
from sim.evaluate.point_errors import distance_mm
from sim.evaluate.score import WRONG_MM

Floats = NDArray[np.float64]
_RIDGE = 3.0
_FIRST_RANDOM = 200
"""Scenes before are for tests of the result."""
_MOST_WRONG = 0.1
"""Share of wrong points from which a scene is left out: there whole surfaces have wrong orders."""
_MOST_OF_A_KIND = 6000
"""Right points of a pair that are fitted to, and wrong ones: more of them take memory and change nothing."""
_CONVERGED = 1e-4
"""Largest change of a coefficient at which an iteration ends."""
_TAIL = np.log(2.0)
"""Added to the logarithm of the variance. Errors have heavier tails than noise: with the mean of all borders as the
variance, error / sigma of the pixels right beside an edge is 1.5 to 2.8 in nine of 18 cases, with this in five."""
_BEGIN = "MODEL = BorderModel("


def samples(case: Case, seed: int) -> tuple[Floats, Floats]:
    """Figures (n, FIGURES) of the border points of one pair, and their error / sigma (n,), inf where wrong."""
    found = np.full(1, np.nan, np.float32)

    def collect(bands: int, planes: Any, losses: Any, stride: int, per_order: Any, *rest: Any) -> None:
        nonlocal found
        found = np.empty((*planes.label.shape, FIGURES), np.float32)
        border_figures(bands, planes, losses, stride, per_order, found)
        _, valid, misfit, _, code, expected = rest
        found[valid == 0] = np.nan
        misfit[np.isfinite(found[..., 0])] = 0
        code[:], expected[:] = 0, 0.0

    pair = rendered.stored_pair(case, seed)
    reconstructor = case.reconstructor()
    # Bends, and the tests by depth, come after the border test, and are not part of its errors.
    with (
        mock.patch.object(point_filter, "border_test", collect),
        mock.patch.object(orders_to_cloud, "widen_at_bends", lambda *_: None),
        mock.patch.object(orders_to_cloud, "mask_unknown", lambda *_: None),
    ):
        cloud = reconstructor.reconstruct(pair.left, pair.right)
    truth = pair.truth_left
    with np.errstate(invalid="ignore"):
        wrong = ~(distance_mm(cloud.xyz, truth) <= WRONG_MM)
        ray = np.linalg.norm(truth.xyz, axis=-1) / truth.xyz[..., 2]
        ratio = np.abs(cloud.xyz[..., 2] - truth.xyz[..., 2]) * ray / cloud.sigma_mm
    at = np.isfinite(found[..., 0]) & np.isfinite(cloud.sigma_mm)
    return found[at].astype(np.float64), np.where(wrong, np.inf, ratio)[at]


def thinned(x: Floats, ratio: Floats) -> tuple[Floats, Floats, Floats]:
    """Some of the points of a pair, with weights that make up for the others.

    Every pair counts by the root of its number of points, so that scenes with many borders do not decide alone.
    """
    rng = np.random.default_rng(0)
    wrong = np.isinf(ratio)
    share = np.minimum(1.0, _MOST_OF_A_KIND / np.where(wrong, wrong.sum(), (~wrong).sum()))
    some = rng.random(len(ratio)) < share
    return x[some], ratio[some], 1 / (share[some] * np.sqrt(len(ratio)))


def quadratic(x: Floats) -> Floats:
    """Constant, linear and quadratic terms, in the order of :func:`pipeline.filter.border.border_test.log_odds`."""
    products = [x[:, k] * x[:, other] for k in range(FIGURES) for other in range(k + 1)]
    return np.column_stack([np.ones(len(x)), x, *products])


def squares(x: Floats) -> Floats:
    """Constant, linear and square terms, in the order of :func:`pipeline.filter.border.border_test.log_variance`."""
    return np.column_stack([np.ones(len(x)), x, x**2])


def logistic(terms: Floats, wrong: NDArray[np.bool_], weight: Floats) -> Floats:
    """Coefficients of a logistic regression with a ridge, by Newton's method with bounded steps."""
    ridge = np.r_[0.0, np.full(terms.shape[1] - 1, _RIDGE)]
    w = np.zeros(terms.shape[1])

    def loss(w: Floats) -> float:
        odds = terms @ w
        return float(weight @ (np.logaddexp(0.0, odds) - wrong * odds) + 0.5 * ridge @ w**2)

    best = loss(w)
    for _ in range(50):
        p = 1 / (1 + np.exp(-np.clip(terms @ w, -30, 30)))
        gradient = terms.T @ (weight * (p - wrong)) + ridge * w
        hessian = (terms.T * (weight * np.maximum(p * (1 - p), 1e-4))) @ terms + np.diag(ridge)
        step = np.linalg.solve(hessian, gradient)
        while loss(w - step) > best and np.abs(step).max() > 1e-9:
            step /= 2
        w, best = w - step, loss(w - step)
        if np.abs(step).max() < _CONVERGED:
            break
    return w


def variance(terms: Floats, ratio: Floats, weight: Floats) -> Floats:
    """Coefficients w of the variance exp(terms w) of ``ratio`` by maximum likelihood, Fisher scoring."""
    ridge = np.r_[0.0, np.full(terms.shape[1] - 1, _RIDGE)]
    w = np.zeros(terms.shape[1])
    w[0] = np.log(np.mean(ratio**2))
    hessian = 0.5 * (terms.T * weight) @ terms + np.diag(ridge)
    for _ in range(200):
        excess = ratio**2 * np.exp(-np.clip(terms @ w, -5, 15)) - 1
        step = np.linalg.solve(hessian, 0.5 * terms.T @ (weight * excess) - ridge * w)
        w += 0.5 * step
        if np.abs(step).max() < _CONVERGED:
            break
    return w


def main(given: list[str]) -> int:
    """Fit, print what a limit costs on every case, and write the coefficients."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scales", type=float, nargs="+", default=[1.0, 0.5])
    parser.add_argument(
        "--without", nargs="*", default=["bright"], help="cases left out of the fit, by part of the name"
    )
    parser.add_argument("--random", type=int, default=80, help="as many random scenes and rigs too, at half size")
    parser.add_argument("--write", action="store_true", help="write the coefficients into the pipeline")
    options = parser.parse_args(given)
    data: dict[str, tuple[Floats, Floats]] = {}
    for case in HARD:
        for size in options.scales:
            for seed in range(options.seeds):
                data[f"{case.name}, {size:g}, {seed}"] = samples(scaled(case, size), seed)
    for number in range(_FIRST_RANDOM, _FIRST_RANDOM + options.random):
        data[f"random {number}"] = samples(scaled(random_case(number), 0.5), 0)
    left_out = {
        name
        for name, (_, ratio) in data.items()
        if any(part in name for part in options.without) or np.isinf(ratio).mean() > _MOST_WRONG
    }
    fitted = [thinned(*points) for name, points in data.items() if name not in left_out and len(points[1])]
    x, ratio, weight = (np.concatenate([each[k] for each in fitted]) for k in range(3))
    weight *= len(weight) / weight.sum()
    mean, scale = x.mean(axis=0), 1 / x.std(axis=0)
    x = (x - mean) * scale
    most = Settings().edge_probability
    good, terms, limit = np.isfinite(ratio), quadratic(x), np.log(most / (1 - most))
    wrong = logistic(terms, ~good, weight)
    kept = good & (terms @ wrong <= limit)
    spread = variance(squares(x[kept]), ratio[kept], weight[kept])
    spread[0] += _TAIL
    for name, (figures, r) in sorted(data.items()):
        figures = (figures - mean) * scale
        bad, odds = ~np.isfinite(r), quadratic(figures) @ wrong
        stays = odds <= limit
        after = r[~bad & stays] * np.exp(-0.5 * np.maximum(squares(figures[~bad & stays]) @ spread, 0.0))
        print(
            f"{name + ' (not fitted)' * (name in left_out):50s} {len(r):6d} points, wrong {bad.sum():5d} -> "
            f"{(bad & stays).sum():5d}, right ones lost {100 * (~bad & ~stays).mean():5.2f} %, "
            f"error / sigma {np.sqrt((r[~bad] ** 2).mean()):5.2f} -> {np.sqrt((after**2).mean()):5.2f}"
        )
    if options.write:
        path = Path(pipeline.filter.border.border_model.__file__)
        head = path.read_text().split(_BEGIN)[0]
        path.write_text(
            head + _BEGIN + "\n" + "".join(_array(a) for a in (mean, scale, wrong, spread)) + ")  # fmt: skip\n"
        )
    return 0


def _array(values: Floats) -> str:
    """An array as Python source, ten numbers a line."""
    rows = [", ".join(f"{v:.4g}" for v in values[k : k + 10]) for k in range(0, len(values), 10)]
    return "    np.array([\n" + "".join(f"        {row},\n" for row in rows) + "    ], np.float32),\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
