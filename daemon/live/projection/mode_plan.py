"""What a multi-frame mode shows on this rig, and its reconstructor; the pipeline's part is loaded when it is needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError
from daemon.config.sections.sequence import Sequencing
from daemon.live.items import SINGLE
from pipeline.pattern.sequence import FrameSequence

if TYPE_CHECKING:
    from daemon.rig.open_rig import Rig
    from pipeline.multi_frame.set_reconstructor import SetReconstructor


@dataclass(frozen=True, slots=True)
class ShownSequence:
    """What a take stores of a sequence: its description, and the values of the metadata record ``fringed`` for it."""

    pattern: Mapping[str, Any]
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class ModePlan:
    """A mode on a rig.

    Args:
        mode: its name; sequence: the descriptions of its frames.
        images: as they are sent to the projector, (H, W, 3) uint8.
    """

    mode: str
    sequence: FrameSequence
    images: list[NDArray[np.uint8]]

    def reconstructor(self, rig: Rig, **options: Any) -> SetReconstructor:
        """Of the mode's sets; options as of :class:`pipeline.multi_frame.set_reconstructor.SetReconstructor`."""
        from pipeline.multi_frame.set_reconstructor import SetReconstructor

        return SetReconstructor(rig.calibration, self.sequence, rig.volume, **options)


def make_plan(mode: str, config: Sequencing, rig: Rig) -> ModePlan | None:
    """Return the plan of a mode, None for the single shot.

    Raises:
        DaemonError: no such mode; PatternError: the projector cannot show such fringes.
    """
    if mode == SINGLE:
        return None
    from pipeline.pattern.mode_sequences import MODES, mode_sequence

    if mode not in MODES:
        raise DaemonError(f"there is no mode {mode!r:.60}; there are {SINGLE}, {', '.join(MODES)}")
    pattern = rig.pattern
    steps: dict[str, Any] = {} if config.steps is None else {"steps": config.steps}
    periods = pattern.periods if config.periods is None else config.periods
    sequence = mode_sequence(mode, pattern.size, periods=periods, axis=pattern.axis, **steps)
    response = rig.calibration.response
    return ModePlan(mode, sequence, [frame.image(response) for frame in sequence.frames])
