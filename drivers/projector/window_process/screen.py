"""Display of images in the window with the times of their flips, and automatic sequences."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError
from drivers.projector.messages import Show, Shown
from drivers.projector.window_process.window import PatternWindow
from drivers.projector.x11.present import VBlank, VBlankClock

VBLANK_S = 1.0
SWAP_S = 0.05


@dataclass(slots=True)
class _Sequence:
    count: int
    hold_frames: int
    loop: bool
    number: int
    due_msc: int
    requested: int


class Screen:
    """Shows images in a window and reports the times of their flips.

    Args:
        window: on the screen; clock: its vertical blanks, None where the server reports none.
    """

    def __init__(self, window: PatternWindow, clock: VBlankClock | None) -> None:
        self._window, self._clock = window, clock
        self._number: int | None = None
        self._sequence: _Sequence | None = None
        self._reports_swaps: bool | None = None
        self.late = 0
        self.wrong_pixels = ""

    def show(self, images: NDArray[np.uint8], show: Show) -> Shown:
        """Show the first of these images; :meth:`take_events` shows the others."""
        self._sequence, self._number = None, None
        self.wrong_pixels = self._window.load(images)
        self._number = 0
        out = self._flip()
        if show.count > 1 and self._clock is not None and out is not None:
            due = out.msc + show.hold_frames
            # An image drawn after vertical blank number n is displayed at n + 1.
            requested = self._clock.request(due - 1)
            self._sequence = _Sequence(show.count, show.hold_frames, show.loop, 0, due, requested)
        elif show.count > 1:
            raise DriverError("this X server reports no vertical blanks, so sequences cannot be shown on it")
        if out is None or not out.t_monotonic_ns:
            return Shown(serial=show.serial, t_monotonic_ns=time.monotonic_ns(), msc=0, source="unverified")
        source = "present" if out.swap else "vblank"
        return Shown(serial=show.serial, t_monotonic_ns=out.t_monotonic_ns, msc=out.msc, source=source)  # type: ignore[arg-type]

    def black(self) -> None:
        """Go dark; return when it is dark, as far as that can be determined."""
        self._sequence, self._number = None, None
        self._window.draw(None)
        self._flip()

    def redraw(self) -> None:
        """Draw the same image again after the window lost its pixels."""
        self._window.draw(self._number)
        self._window.flip()

    def take_events(self) -> None:
        """Advance a sequence at the vertical blank that it waits for."""
        if self._clock is None:
            return
        for event in self._clock.events():
            if self._sequence is not None and not event.swap and event.serial == self._sequence.requested:
                self._advance(self._sequence, event.msc)

    def _advance(self, sequence: _Sequence, msc: int) -> None:
        assert self._clock is not None  # noqa: S101 - for the type checker
        out_msc = max(msc + 1, sequence.due_msc)
        self.late += out_msc > sequence.due_msc
        sequence.number += 1
        if sequence.number == sequence.count:
            if not sequence.loop:
                self._sequence = None
                return
            sequence.number = 0
        self._number = sequence.number
        self._window.draw(self._number)
        self._window.flip()
        if sequence.number + 1 == sequence.count and not sequence.loop:
            self._sequence = None
            return
        sequence.due_msc = out_msc + sequence.hold_frames
        sequence.requested = self._clock.request(sequence.due_msc - 1)

    def _flip(self) -> VBlank | None:
        """Flip and wait for the vertical blank at which the image is displayed; None if the server reports none."""
        if self._clock is None:
            self._window.flip()
            return None
        if any(event.swap for event in self._clock.events()):
            self._reports_swaps = True
        self._window.flip()
        requested = self._clock.request()
        vblank: VBlank | None = None
        swap: VBlank | None = None
        deadline = time.monotonic() + VBLANK_S
        while (left := deadline - time.monotonic()) > 0:
            for event in self._clock.wait(left):
                if event.swap:
                    swap = event
                elif event.serial == requested:
                    vblank = event
            if swap is not None or (vblank is not None and self._reports_swaps is False):
                break
            if vblank is not None and self._reports_swaps is None:
                deadline = min(deadline, time.monotonic() + SWAP_S)
        self._reports_swaps = swap is not None or bool(self._reports_swaps)
        return swap or vblank
