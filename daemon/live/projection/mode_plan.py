"""What a multi-frame mode shows on this rig, and what measures it; the pipeline's part is loaded if one is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError
from daemon.config.sequence import Sequencing
from daemon.live.sets import SINGLE
from pipeline.pattern.sequence import FrameSequence
from pipeline.reconstruct.cloud import Cloud

if TYPE_CHECKING:
    from daemon.rig.open_rig import Rig
    from pipeline.multi_frame.set_reconstructor import SetReconstructor


@dataclass(frozen=True, slots=True, eq=False)
class ModePlan:
    """A mode on a rig.

    Args:
        mode: its name; sequence: the descriptions of its images.
        images: as they are sent to the projector, (H, W, 3) uint8.
    """

    mode: str
    sequence: FrameSequence
    images: list[NDArray[np.uint8]]

    def reconstructor(self, rig: Rig, **options: Any) -> SetMeasure:
        """What measures the sets; options as of :class:`pipeline.multi_frame.set_reconstructor.SetReconstructor`."""
        from pipeline.multi_frame.set_reconstructor import SetReconstructor

        return SetMeasure(self.mode, SetReconstructor(rig.calibration, self.sequence, rig.volume, **options))


class SetMeasure:
    """A reconstructor of sets that tells which mode it is for."""

    def __init__(self, mode: str, made: SetReconstructor) -> None:
        self.mode, self._made = mode, made

    def warm_up(self) -> None:
        """Compile every kernel."""
        self._made.warm_up()

    def reconstruct(self, lefts: Any, rights: Any) -> Cloud:
        """The cloud of a set."""
        return self._made.reconstruct(lefts, rights)


def make_plan(mode: str, config: Sequencing, rig: Rig) -> ModePlan | None:
    """The plan of a mode, None for the single shot.

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
