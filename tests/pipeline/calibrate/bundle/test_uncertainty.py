"""The reported standard deviations agree with the scatter of repeated sessions."""

import numpy as np
import pytest

from pipeline.calibrate.bundle import calibrate
from pipeline.calibrate.bundle.adjust.uncertainty import noise_floor
from pipeline.calibrate.bundle.quality.depth_sigma import distances
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.calibrate.targets.marks import BoardView, Marks
from tests.pipeline.calibrate.bundle.sessions import session


@pytest.mark.long
def test_standard_deviations_agree_with_the_scatter_of_twenty_sessions():
    """Although the expected noise of the marks (0.02 px) is less than the true one (0.03 px)."""
    values, reported = [], []
    start = session()[2]
    for seed in range(20):
        views, sizes, _ = session(sigma=0.03, expected_sigma=0.02, seed=seed)
        solution = calibrate(DEFAULT_BOARD, views, sizes, start=start)
        values.append(solution.values)
        reported.append(solution.sigma)
        assert solution.rejected == ()
        # 0.03 px in both coordinates, less what the parameters take.
        assert all(abs(rms / (0.03 * np.sqrt(2)) - 1) < 0.05 for rms in solution.rms.values())
    ratios = {}
    for name in reported[0]:
        if name.startswith(("left.rotation", "left.translation")):
            assert reported[0][name] == 0
            continue
        scatter = np.std([one[name] for one in values], ddof=1)
        ratios[name] = scatter / np.mean([one[name] for one in reported])
    assert min(ratios.values()) > 1 / 1.5 and max(ratios.values()) < 1.5, ratios
    assert abs(np.median(list(ratios.values())) - 1) < 0.15
    assert {"baseline_mm", "angle_deg", "left.fx", "right.rotation_y", "projector.cx"} <= set(ratios)


def test_errors_agree_with_their_standard_deviations():
    """Over all parameters of one session: the Mahalanobis distance of the truth is that of a chi-square."""
    views, sizes, truth = session(sigma=0.03, seed=11)
    solution = calibrate(DEFAULT_BOARD, views, sizes)
    exact = calibrate(DEFAULT_BOARD, session(seed=11)[0], sizes, start=truth)
    free = [k for k, name in enumerate(solution.names) if solution.sigma[name] > 0]
    deviation = np.array([solution.values[solution.names[k]] - exact.values[solution.names[k]] for k in free])
    covariance = solution.covariance[np.ix_(free, free)]
    size = np.sqrt(np.diag(covariance))
    squared = (deviation / size) @ np.linalg.solve(covariance / np.outer(size, size), deviation / size)
    assert len(free) == 42
    assert 42 - 4 * np.sqrt(84) < squared < 42 + 4 * np.sqrt(84)


def test_each_device_has_its_own_noise():
    noise = {"left": 0.02, "right": 0.05, "projector": 0.2}
    rng = np.random.default_rng(0)
    views, sizes, _ = session()
    noisy = [
        BoardView(v.name, {d: Marks(m.ids, m.pixels + noise[d] * rng.standard_normal((len(m), 2)), m.sigma_px)
                           for d, m in v.marks.items()})
        for v in views
    ]  # fmt: skip
    solution = calibrate(DEFAULT_BOARD, noisy, sizes)
    for name, sigma in noise.items():
        assert abs(solution.noise_px[name] / sigma - 1) < 0.06
        assert abs(solution.sigma0[name] / (sigma / 0.02) - 1) < 0.06
    assert solution.rejected == ()


@pytest.mark.parametrize(("floor", "factor"), [(0.0, 1.0), (0.04, 1.0), (0.3, 1.0), (0.0, 0.4)])
def test_the_noise_floor_is_estimated(floor, factor):
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.01, 0.1, 20_000)
    squares = (np.hypot(factor * sigma, floor)[:, None] ** 2 * rng.standard_normal((20_000, 2)) ** 2).sum(axis=1)
    estimate = noise_floor(squares, sigma, 40_000.0)
    spread = np.hypot(estimate[1] * sigma, estimate[0])
    assert np.abs(np.sqrt((squares / spread**2).sum() / 40_000) - 1) < 1e-6
    assert abs(estimate[0] - floor) < 0.01 * floor + 0.005 and abs(estimate[1] - factor) < 0.02


@pytest.mark.long
def test_depths_scatter_over_sessions_as_the_calibration_reports():
    """Fixed pixels of both cameras, triangulated with the calibrations of eight sessions."""
    start, depths, reported = session()[2], [], []
    grid = np.stack(np.meshgrid(np.linspace(-120, 120, 7), np.linspace(-90, 90, 5), [1300.0, 1400.0]), -1).reshape(
        -1, 3
    )
    pixels = [start[name].project(grid) for name in ("left", "right")]
    for seed in range(8):
        views, sizes, _ = session(sigma=0.03, seed=100 + seed)
        solution = calibrate(DEFAULT_BOARD, views, sizes, start=start)
        cameras = [solution.devices[name] for name in ("left", "right")]
        depths.append(distances(cameras, pixels))
        reported.append(solution.sigma_calibration_mm)
        assert solution.quality()["sigma_calibration_mm"] == pytest.approx(reported[-1], abs=1e-4)
    scatter = float(np.sqrt(np.var(depths, axis=0, ddof=1).mean()))
    assert scatter / np.mean(reported) == pytest.approx(1, abs=0.5)
