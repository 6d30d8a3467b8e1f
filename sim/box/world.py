"""The light between the projector's output and the cameras: they see the image that is really shown.

At each trigger the world reads the pixels that the X server shows on the projector's output, lights the scene with
them, exposes both emulated sensors and sets an edge of the same time on both trigger lines. In lock-step
(:meth:`World.step`) the next trigger waits until this one's frames have left the cameras, so nothing depends on the
machine's speed; :meth:`World.run` triggers at a rate instead.

Faults come from the plan of the simulated rig, with these effects:

================  ======================================================================================
``lost``          the frame never leaves the camera; at odd triggers half of it does (an incomplete frame)
``late``          the camera's frames are held back for ``length`` periods
``duplicate``     a second edge while the sensor is still busy with the first (over-triggering)
``extra_first``   one edge too many on this side before the first trigger
``wrong_number``  the edge does not reach this side, so its camera counts one frame less from then on
``blackout``      no edges at all for ``length`` triggers
``gone``          the camera is unplugged for ``length`` triggers
================  ======================================================================================
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import SIDES, Side
from sim.box.exposure_ledger import Ledger, Trigger, digest
from sim.box.output_grabber import DisplayLost
from sim.devices.faults import FaultKind, FaultPlan
from sim.render.projection_transport import Counts
from sim.render.render_pair import Image

_NO_EDGE = (FaultKind.WRONG_NUMBER, FaultKind.BLACKOUT, FaultKind.GONE)


class CameraCable(Protocol):
    """The world's side of one emulated camera."""

    def show(self, image: Image) -> object:
        """Expose the sensor to this image from now on."""

    def pulse(self, t_ns: int | None = None) -> object:
        """Set an edge on the trigger line at a time of CLOCK_MONOTONIC."""

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until all frames of the edges so far have left the camera, or never will."""

    def drop(self, count: int = 1) -> None:
        """Lose the next frames."""

    def truncate(self, count: int = 1) -> None:
        """Send the next frames incomplete."""

    def stall(self, seconds: float) -> None:
        """Hold frames back for a time."""

    def unplug(self) -> None:
        """Unplug the camera."""

    def plug(self) -> None:
        """Plug the camera in."""


class Screen(Protocol):
    """The projector's output."""

    def grab(self) -> NDArray[np.uint8]:
        """(H, W, 3) uint8; DisplayLost while there is nothing to read."""


class Lit(Protocol):
    """The scene under any light."""

    def counts(self, image: NDArray[np.uint8], instant: int = 0) -> Counts:
        """Both cameras' counts without noise."""

    def images(self, counts: Counts, seed: int) -> tuple[Image, Image]:
        """Both cameras' images with the noise of a seed."""


class NotSettled(RuntimeError):
    """A camera still has frames of an edge after the longest wait of lock-step."""


class World:
    """Triggers the cameras under the projected light; its methods are for one thread.

    Args:
        screen: the projector's output.
        stage: the scene, rendered for ``instants`` instants that follow each other, one a trigger.
        cables: to the cameras.
        size: (width, height) of the projector; any other size on the screen counts as dark.
        plan: what goes wrong.
        period_s: least time between two triggers, also in lock-step; at least the cameras' exposure and readout.
        settle_s: longest wait of lock-step; NotSettled is raised after it.
        ledger: that records the triggers.
        lit_images: projected images whose counts are kept, so that showing one again costs only noise.
    """

    def __init__(
        self,
        screen: Screen,
        stage: Lit,
        cables: Mapping[Side, CameraCable],
        *,
        size: tuple[int, int],
        instants: int = 1,
        plan: FaultPlan | None = None,
        period_s: float = 0.02,
        settle_s: float = 10.0,
        ledger: Ledger | None = None,
        lit_images: int = 8,
    ) -> None:
        self.ledger = ledger or Ledger()
        self.late = 0
        self.display_problem = ""
        self._screen, self._stage, self._cables = screen, stage, dict(cables)
        self._dark = np.zeros((size[1], size[0], 3), np.uint8)
        self._instants, self._plan = instants, plan or FaultPlan.none()
        self._period_s, self._settle_s = period_s, settle_s
        self._index, self._next_ns = 0, 0
        self._gone: set[Side] = set()
        self._lit: OrderedDict[tuple[bytes, int], Counts] = OrderedDict()
        self._lit_room = max(1, lit_images) * instants
        self._last_image, self._last_digest = self._dark, digest(self._dark)

    @property
    def triggers(self) -> int:
        """Triggers given so far."""
        return self._index

    def set_stage(self, stage: Lit, *, instants: int = 1) -> None:
        """Use another scene from the next trigger on."""
        self._stage, self._instants = stage, instants
        self._lit.clear()

    def step(self, *, settle: bool = True) -> Trigger:
        """Trigger once and, in lock-step, wait until the frames have left the cameras.

        Raises:
            NotSettled: they have not within ``settle_s``.
        """
        image, dark = self._grab()
        index, instant = self._index, self._index % self._instants
        images = dict(zip(SIDES, self._stage.images(self._counts(image, instant), index), strict=True))
        faults = {side: self._plan.of(index, side).kind for side in SIDES}
        for side in SIDES:
            self._replug(side, gone=faults[side] is FaultKind.GONE)
            self._cables[side].show(images[side])
        if index == 0:
            self._extra_first()
        t_ns = self._wait_for_turn()
        exposures = {side: digest(images[side]) for side in SIDES}
        shown = Trigger(index, t_ns, self._last_digest, dark, instant, faults, exposures)
        self.ledger.note(shown)
        self._index += 1
        for side in SIDES:
            self._edge(index, side, t_ns)
        if settle:
            self.settle()
        return shown

    def replug(self) -> None:
        """Plug and unplug the cameras as the next trigger requires."""
        for side in SIDES:
            self._replug(side, gone=self._plan.gone(self._index, side))

    def settle(self) -> None:
        """Wait until the frames of all edges so far have left the present cameras."""
        deadline = time.monotonic() + self._settle_s
        for side in SIDES:
            if side not in self._gone and not self._cables[side].wait_idle(max(0.0, deadline - time.monotonic())):
                raise NotSettled(f"camera {side}: frames have not left it within {self._settle_s} s")

    def run(self, rate_hz: float, stop: threading.Event) -> None:
        """Trigger at a rate until ``stop`` is set; late triggers are skipped and counted in ``late``."""
        if not 0 < rate_hz <= 1000:
            raise ValueError(f"rate_hz is {rate_hz}, expected more than 0, at most 1000")
        period = 1 / rate_hz
        due = time.monotonic()
        while not stop.wait(max(0.0, due - time.monotonic())):
            self.step(settle=False)
            due += period
            if (behind := time.monotonic() - due) > period:
                self.late += int(behind / period)
                due += int(behind / period) * period

    def _grab(self) -> tuple[NDArray[np.uint8], bool]:
        try:
            image = self._screen.grab()
            self.display_problem = ""
        except DisplayLost as error:
            image, self.display_problem = self._dark, str(error)
        if image.shape != self._dark.shape:
            self.display_problem = f"the output shows {image.shape[1]} x {image.shape[0]} pixels"
            image = self._dark
        if not np.array_equal(image, self._last_image):
            self._last_image, self._last_digest = image, digest(image)
        return image, bool(self.display_problem)

    def _counts(self, image: NDArray[np.uint8], instant: int) -> Counts:
        key = self._last_digest, instant
        if key in self._lit:
            self._lit.move_to_end(key)
        else:
            if len(self._lit) >= self._lit_room:
                self._lit.popitem(last=False)
            self._lit[key] = self._stage.counts(image, instant)
        return self._lit[key]

    def _wait_for_turn(self) -> int:
        """Time of the edges: now, or as soon as the sensors are ready again."""
        wait_ns = self._next_ns - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns / 1e9)
        now_ns = time.monotonic_ns()
        self._next_ns = now_ns + round(1e9 * self._period_s)
        return now_ns

    def _replug(self, side: Side, *, gone: bool) -> None:
        if gone != (side in self._gone):
            (self._cables[side].unplug if gone else self._cables[side].plug)()
            (self._gone.add if gone else self._gone.discard)(side)

    def _extra_first(self) -> None:
        sides = [side for side in SIDES if self._plan.extra_first(side)]
        if sides:
            t_ns = self._wait_for_turn()
            for side in sides:
                self._cables[side].pulse(t_ns)

    def _edge(self, index: int, side: Side, t_ns: int) -> None:
        cable, fault = self._cables[side], self._plan.of(index, side)
        if fault.kind is FaultKind.LOST:
            (cable.truncate if index % 2 else cable.drop)(1)
        elif fault.kind is FaultKind.LATE:
            cable.stall(fault.length * self._period_s)
        if fault.kind not in _NO_EDGE:
            cable.pulse(t_ns)
        if fault.kind is FaultKind.DUPLICATE:
            cable.pulse(t_ns + 1000)
