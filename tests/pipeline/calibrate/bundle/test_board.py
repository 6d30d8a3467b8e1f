"""A board that is not flat, or not printed to scale, is estimated together with the rig."""

import numpy as np
import pytest

from pipeline.calibrate.bundle import Options, calibrate
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.common.errors import CalibrationError
from tests.pipeline.calibrate.bundle.sessions import session

PAIR = ("left", "right")


def bent() -> np.ndarray:
    """Bent by 1.5 mm, and each mark displaced by random print errors."""
    points = DEFAULT_BOARD.points
    middle, half = points.mean(axis=0), np.ptp(points, axis=0)[:2] / 2
    x, y = ((points - middle)[:, :2] / half).T
    rng = np.random.default_rng(3)
    return points + np.stack([0 * x, 0 * x, 1.5 * (x**2 - 0.4 * y + 0.3 * x * y)], 1) + rng.normal(0, 0.05, (99, 3))


def gauged(points: np.ndarray) -> np.ndarray:
    """The same shape, fitted to the nominal grid with the best scale (Procrustes)."""
    nominal = DEFAULT_BOARD.points
    a, b = points - points.mean(axis=0), nominal - nominal.mean(axis=0)
    for _ in range(20):
        u, _, vt = np.linalg.svd(b.T @ a)
        a = a @ (u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt).T
        # The linear gauge: the part of the deviation along the grid itself is zero.
        a = a * ((b * b).sum() / (a * b).sum())
    return a + nominal.mean(axis=0)


def test_exact_marks_of_a_bent_board_give_rig_and_board():
    views, sizes, truth = session(points=bent())
    solution = calibrate(DEFAULT_BOARD, views, sizes, options=Options(board_refined=True))
    expected = gauged(bent())
    factor = np.linalg.norm(expected[98] - expected[0]) / np.linalg.norm(bent()[98] - bent()[0])
    assert np.abs(solution.board_points - expected).max() < 1e-4
    for name, model in solution.devices.items():
        assert np.abs(model.matrix - truth[name].matrix).max() < 1e-3
        assert np.abs(model.translation - factor * truth[name].translation).max() < 1e-3
    assert "mean pitch" in solution.scale


def test_a_ruler_fixes_the_scale():
    views, sizes, _ = session(points=1.01 * bent(), devices=PAIR)
    length = float(np.linalg.norm(1.01 * (bent()[98] - bent()[0])))
    options = Options(board_refined=True, known_distance=(0, 98, length))
    solution = calibrate(DEFAULT_BOARD, views, sizes, options=options)
    assert abs(solution.baseline_mm - 500) < 1e-3
    assert "marks 0 and 98" in solution.scale
    flat_views, sizes, _ = session(points=1.01 * DEFAULT_BOARD.points)
    length = 1.01 * float(np.linalg.norm(DEFAULT_BOARD.points[98]))
    flat = calibrate(DEFAULT_BOARD, flat_views, sizes, options=Options(known_distance=(0, 98, length)))
    assert abs(flat.baseline_mm - 500) < 1e-6
    with pytest.raises(CalibrationError, match="marks 0 and 99"):
        calibrate(DEFAULT_BOARD, flat_views, sizes, options=Options(known_distance=(0, 99, length)))


@pytest.mark.long
def test_refining_the_board_of_noisy_views_removes_the_bias_of_a_bent_one():
    views, sizes, truth = session(points=bent(), sigma=0.02, n=16, devices=PAIR)
    plain = calibrate(DEFAULT_BOARD, views, sizes)
    refined = calibrate(DEFAULT_BOARD, views, sizes, options=Options(board_refined=True))

    def error(solution):
        return abs(solution.devices["left"].matrix[0, 0] - truth["left"].matrix[0, 0])

    assert max(refined.rms.values()) < 0.02 * 1.5 < max(plain.rms.values()) / 3
    assert error(refined) < 3 * refined.sigma["left.fx"] and error(refined) < error(plain) / 3
    assert refined.board_sigma_mm is not None
    away = np.abs(refined.board_points - gauged(bent()))
    assert np.sqrt(((away / refined.board_sigma_mm) ** 2).mean()) < 1.6
    assert np.abs(refined.sigma0["left"] - 1) < 0.1


def test_a_flat_board_stays_flat():
    views, sizes, _ = session(sigma=0.02, devices=PAIR)
    refined = calibrate(DEFAULT_BOARD, views, sizes, options=Options(board_refined=True))
    away = refined.board_points - DEFAULT_BOARD.points
    assert np.sqrt(((away / refined.board_sigma_mm) ** 2).mean()) < 1.6
