"""The verdicts of the calibration check on the clouds of a run: the last one, changes in the log, what was withheld."""

from __future__ import annotations

import logging

from pipeline.monitor.check.checked_reconstructor import Policy
from pipeline.reconstruct.consistency import Consistency, Verdict

log = logging.getLogger("fringed.pipeline")


class CalibrationVerdicts:
    """Notes the verdict of each cloud."""

    def __init__(self) -> None:
        self._reported: Verdict = "consistent"
        self.last: Consistency | None = None
        """Of the last cloud; None = it was not judged."""
        self.withheld = 0
        """Clouds that were published without points."""

    def note(self, consistency: Consistency | None, policy: Policy) -> None:
        """Count a cloud, and log a verdict that differs from the last one that was not ``unknown``.

        Args:
            policy: what happened with the points if the pair is inconsistent.
        """
        self.last = consistency
        if consistency is None:
            return
        verdict = consistency.verdict
        self.withheld += verdict == "inconsistent" and policy == "withhold"
        if verdict in ("unknown", self._reported):
            return
        self._reported = verdict
        if verdict == "consistent":
            log.info("calibration check: consistent again")
        else:
            log.warning("calibration check: %s: %s", verdict, consistency.reason)
