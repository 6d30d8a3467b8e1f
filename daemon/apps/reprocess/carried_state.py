"""What runs from one item of a recording to the next, as plain values that travel between processes.

In the mode single and in sets it is the projector's column correction, the cameras' response and the column scan of the
first pair with points; the sets themselves are made by the plan, and neither a temporal prior nor an average of clouds
crosses the border of a chunk.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from daemon.apps.replay.independent_verdicts import IndependentVerdicts
from pipeline.monitor.check.checked_reconstructor import FirstPair
from pipeline.multi_frame.set_reconstructor import SetReconstructor
from pipeline.reconstruct.camera_response import EQUAL
from pipeline.reconstruct.consistency import ColumnScan

_LENGTHS = 3, 3 + len(EQUAL)
"""Numbers of a column correction, alone or with the cameras' response."""


@dataclass(frozen=True, slots=True)
class CarriedState:
    """The state of a reconstructor between two items; the state before any item has no encoding.

    Args:
        encoding: of the images seen last; another one begins with a new reconstructor.
        corrections: what the first item sets in each inner reconstructor, and whether it was measured.
        scan: fields of the first pair's column scan, None without one.
        shifts, gain: of the correction, see :class:`pipeline.fringe_order.margins.order_margins.Limits`.
    """

    encoding: str = ""
    corrections: tuple[tuple[tuple[float, ...], bool], ...] = ()
    scan: tuple[float, ...] | None = None
    shifts: tuple[float, ...] = ()
    gain: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether no later item of this encoding changes it."""
        return bool(self.corrections) and all(measured for _, measured in self.corrections)

    def as_json(self) -> dict[str, Any]:
        """Values for a manifest; numbers are kept to the last bit."""
        return {
            "encoding": self.encoding,
            "corrections": [[list(values), measured] for values, measured in self.corrections],
            "scan": None if self.scan is None else list(self.scan),
            "shifts": list(self.shifts),
            "gain": self.gain,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> CarriedState:
        """The state of a manifest; KeyError, ValueError or TypeError where part of it is missing or no number."""
        scan = None if values["scan"] is None else _numbers(values["scan"])
        if scan is not None and len(scan) != len(dataclasses.fields(ColumnScan)):
            raise ValueError(f"scan has {len(scan)} numbers, expected {len(dataclasses.fields(ColumnScan))}")
        corrections = tuple((_numbers(numbers), bool(measured)) for numbers, measured in values["corrections"])
        for numbers, _ in corrections:
            if len(numbers) not in _LENGTHS:
                raise ValueError(f"corrections have {len(numbers)} numbers, expected {_LENGTHS[0]} or {_LENGTHS[1]}")
        return cls(
            str(values["encoding"]),
            corrections,
            scan,
            _numbers(values["shifts"]),
            float(values["gain"]),
        )


def capture(reconstructor: IndependentVerdicts | SetReconstructor) -> CarriedState:
    """The state that a reconstructor's next item meets."""
    if isinstance(reconstructor, IndependentVerdicts):
        inner = reconstructor.inner
        scan = None if inner.scan is None else tuple(map(float, dataclasses.astuple(inner.scan)))
        values, measured = inner.state()
        corrections = ((_numbers(values), measured),)
        return CarriedState(inner.encoding, corrections, scan, _numbers(inner.other_shifts), inner.gain)
    kept = reconstructor.state()
    return CarriedState(reconstructor.encoding, tuple((_numbers(values), measured) for values, measured in kept))


def restore(reconstructor: IndependentVerdicts | SetReconstructor, state: CarriedState) -> None:
    """Bring a reconstructor into a state that :func:`capture` returned for one of the same kind."""
    pairs = [(np.array(values), measured) for values, measured in state.corrections]
    if isinstance(reconstructor, IndependentVerdicts):
        scan = None if state.scan is None else ColumnScan(*state.scan)
        FirstPair(pairs[0], scan, np.array(state.shifts), state.gain).restore(reconstructor.inner)
        return
    reconstructor.restore(pairs)


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(map(float, values))
