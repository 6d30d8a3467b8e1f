"""A change of the calibration check's verdict is logged once, from the first cloud on."""

from __future__ import annotations

import pytest

from daemon.live.processing.calibration_verdicts import CalibrationVerdicts
from pipeline.reconstruct.consistency import Consistency

LOGGER = "fringed.pipeline"


@pytest.mark.parametrize(
    ("verdicts", "logged"),
    [
        (["consistent", "unknown", "consistent"], []),
        (["doubtful", "doubtful"], ["doubtful: turned"]),
        (["unknown", "doubtful", "unknown", "doubtful"], ["doubtful: turned"]),
        (["doubtful", "unknown", "inconsistent"], ["doubtful: turned", "inconsistent: turned"]),
        (["inconsistent", "unknown", "consistent", "consistent"], ["inconsistent: turned", "consistent again"]),
    ],
)
def test_a_change_is_logged_once(verdicts: list[str], logged: list[str], caplog: pytest.LogCaptureFixture) -> None:
    noted = CalibrationVerdicts()
    with caplog.at_level("INFO", LOGGER):
        for verdict in verdicts:
            noted.note(Consistency(verdict, findings=("turned",)), "warn")  # type: ignore[arg-type]
    assert [line.removeprefix("calibration check: ") for line in caplog.messages] == logged
    assert noted.last is not None and noted.last.verdict == verdicts[-1]


def test_withheld_clouds_are_counted() -> None:
    noted = CalibrationVerdicts()
    for verdict, policy in (("inconsistent", "withhold"), ("inconsistent", "warn"), ("doubtful", "withhold")):
        noted.note(Consistency(verdict), policy)  # type: ignore[arg-type]
    noted.note(None, "off")
    assert noted.withheld == 1 and noted.last is None
