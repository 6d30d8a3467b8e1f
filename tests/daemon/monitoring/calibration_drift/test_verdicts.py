"""Verdicts: lasting changes are reported soon, noise never, and what cannot be observed is named so."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np
import pytest

from daemon.config.rig_config import SelfCheckLimits
from daemon.monitoring.calibration_drift.explanation import describe
from daemon.monitoring.calibration_drift.verdicts import (
    LEARN,
    SURFACE,
    WINDOW,
    Assessor,
    Limit,
    Reference,
    Verdict,
    limits_of,
)
from pipeline.monitor import OBSERVABLES
from pipeline.monitor.observe import Reading

LIMITS = {"column_px": Limit(0.04, 0.6), "epipolar_px": Limit(0.1, 0.6), SURFACE: Limit(1.0)}
KNOWN = {"column_px": Reference(0.01, 0.001)}
SIGMA = 0.002


def run(assessor: Assessor, values: Iterable[float], *, start_s: float = 0.0, sigma: float = SIGMA) -> list[Verdict]:
    """Verdicts on the trinocular residual after each of these readings, five a second."""
    out = []
    for number, value in enumerate(values):
        assessor.feed(start_s + number / 5, {"column_px": Reading(float(value), sigma)})
        out.append(assessor.assessments["column_px"].verdict)
    return out


def noise(n: int, *, middle: float = 0.01, seed: int = 0) -> np.ndarray:
    return np.asarray(middle + SIGMA * np.random.default_rng(seed).standard_normal(n))


def test_every_observable_has_a_limit() -> None:
    assert set(limits_of(SelfCheckLimits())) == {*OBSERVABLES, SURFACE}


def test_noise_is_never_reported_in_ten_thousand_readings() -> None:
    assessor = Assessor(LIMITS, {})
    verdicts = run(assessor, noise(10_000))
    assert set(verdicts[: LEARN - 1]) <= {Verdict.LEARNING} and set(verdicts[LEARN:]) == {Verdict.OK}


def test_a_step_is_reported_within_two_seconds_and_its_end_as_well() -> None:
    assessor = Assessor(LIMITS, KNOWN)
    before = run(assessor, noise(50))
    after = run(assessor, noise(50, middle=0.07, seed=1), start_s=10)
    again = run(assessor, noise(50, seed=2), start_s=20)
    assert Verdict.DRIFTED not in before
    assert after.index(Verdict.DRIFTED) < 10 and set(after[10:]) == {Verdict.DRIFTED}
    assert again.index(Verdict.OK) < 10 and set(again[10:]) == {Verdict.OK}


def test_single_pairs_that_are_wrong_change_nothing() -> None:
    values = noise(400)
    values[::5] += 3.0
    assert Verdict.DRIFTED not in run(Assessor(LIMITS, KNOWN), values)


def test_a_slow_drift_is_reported_at_the_limit() -> None:
    values = noise(2000) + np.linspace(0, 0.08, 2000)
    first = run(Assessor(LIMITS, KNOWN), values).index(Verdict.DRIFTED)
    assert 0.035 < values[first] - 0.01 < 0.055


def test_what_trembles_at_the_limit_does_not_flicker() -> None:
    verdicts = run(Assessor(LIMITS, KNOWN), 0.0505 + np.tile([0.001, -0.001], 200) * np.linspace(0, 3, 400))
    changes = sum(a != b for a, b in pairwise(verdicts))
    assert changes <= 2


def test_a_disturbance_while_the_daemon_was_off_is_reported_at_the_next_start() -> None:
    first = Assessor(LIMITS, {})
    run(first, noise(100))
    assert set(first.references) == {"column_px"}
    assert Verdict.DRIFTED in run(Assessor(LIMITS, first.references), noise(20, middle=0.11))


def test_a_rig_that_never_fitted_is_reported_and_no_reference_is_learned() -> None:
    assessor = Assessor(LIMITS, {})
    assert run(assessor, noise(100, middle=0.9))[-1] is Verdict.DRIFTED
    assert not assessor.references


def test_the_scatter_of_the_scene_widens_the_limit() -> None:
    assessor = Assessor(LIMITS, {"column_px": Reference(0.0, 0.05)})
    assert Verdict.DRIFTED not in run(assessor, noise(100, middle=0.1))
    assert assessor.assessments["column_px"].limit == pytest.approx(0.15)


def test_what_the_scene_does_not_show_is_not_observable() -> None:
    assessor = Assessor(LIMITS, KNOWN)
    assert run(assessor, noise(30), sigma=1.0)[-1] is Verdict.UNOBSERVABLE
    assessor = Assessor(LIMITS, KNOWN)
    run(assessor, noise(30))
    assessor.feed(100.0, {})
    assert assessor.assessments["column_px"].verdict is Verdict.UNOBSERVABLE


def test_a_drift_stays_reported_while_nothing_is_observable() -> None:
    assessor = Assessor(LIMITS, KNOWN)
    run(assessor, noise(30, middle=0.2))
    assessor.feed(100.0, {})
    assert assessor.assessments["column_px"].verdict is Verdict.DRIFTED
    assert run(assessor, noise(30), start_s=101)[-1] is Verdict.OK


def test_numbers_that_are_not_finite_are_not_taken() -> None:
    assessor = Assessor(LIMITS, KNOWN)
    run(assessor, [np.nan, np.inf] * 10)
    assert assessor.assessments["column_px"].verdict is Verdict.UNOBSERVABLE


@pytest.mark.parametrize(("share", "drifted"), [(0.5, False), (0.2, False), (0.02, True)])
def test_fringes_without_points_are_reported(share: float, drifted: bool) -> None:
    assessor = Assessor(LIMITS, {SURFACE: Reference(0.8, 0.01)})
    for number in range(2 * WINDOW):
        assessor.feed(number / 5, {}, surface=Reading(share, 0.01))
    assert (SURFACE in assessor.drifted) is drifted
    assert ("moved far" in describe(assessor.drifted)) is drifted


def changed(values: Mapping[str, float]) -> str:
    """The explanation of these changes of observables."""
    assessor = Assessor(limits_of(SelfCheckLimits()), {name: Reference(0.0, 0.0) for name in values})
    for number in range(2 * WINDOW):
        assessor.feed(number / 5, {name: Reading(value, 0.0005) for name, value in values.items()})
    return describe(assessor.drifted)


def test_the_explanation_names_the_thing_the_value_the_limit_and_the_next_step() -> None:
    text = changed({"column_px": 0.31})
    assert "trinocular residual +0.310 px" in text and "limit 0.040" in text and "fringed calibrate check" in text
    text = changed({"right_green_rad": 0.02, "right_red_rad": -0.01})
    assert "crosstalk of the right camera" in text and "green" in text and "calibrate color" in text
    assert "modulation 0.30 of the mean, was" in changed_modulation()
    assert changed({"column_px": 0.001}) == ""


def changed_modulation() -> str:
    assessor = Assessor(limits_of(SelfCheckLimits()), {"left_modulation": Reference(0.8, 0.01)})
    for number in range(2 * WINDOW):
        assessor.feed(number / 5, {"left_modulation": Reading(0.3, 0.001)})
    return describe(assessor.drifted)
