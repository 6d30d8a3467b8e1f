"""A projector at an output of the graphics card, pixel by pixel."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError, SettingRefused
from drivers.projector.hooks import run_hooks
from drivers.projector.messages import BYTES_LIMIT, SEQUENCE_LIMIT, Setup, Shown
from drivers.projector.options import ProjectorOptions
from drivers.projector.window_process.supervisor import Supervisor
from drivers.protocols import Flip, ProjectorInfo


class OutputProjector:
    """Shows images on a RandR output, in a window whose process is supervised and restarted when it dies.

    Args:
        options: see :class:`drivers.projector.options.ProjectorOptions`; directory: of the hooks.
        hung_s: time without a message after which the window counts as hung.
    """

    def __init__(self, options: ProjectorOptions, directory: Path, *, hung_s: float = 6.0) -> None:
        self.options = options
        self.notes: tuple[str, ...] = ()
        self._directory, self._hung_s = directory, hung_s
        self._first_flip: Flip | None = None
        self._last_flip: Flip | None = None
        self._supervisor: Supervisor | None = None
        self._info: ProjectorInfo | None = None

    def open(self) -> ProjectorInfo:
        """Check the output and put a black window on it; return at once where that is done already.

        Raises:
            DriverError: no display, no such output, or a hook failed.
            SettingRefused: the output would change pixels or their values; the message names the next step.
        """
        if self._info is not None:
            return self._info
        display = self.options.display_name()
        self._run_hooks(self.options.hook.open)
        setup = Setup(options=self.options, display=display)
        supervisor = Supervisor(setup, after_show=self._after_show, hung_s=self._hung_s)
        try:
            opened = supervisor.open()
        except BaseException:
            supervisor.close()
            raise
        self._supervisor, self.notes = supervisor, opened.notes
        refresh_hz = opened.output.refresh_hz
        latency_s = self.options.latency_s(refresh_hz)
        self._info = ProjectorInfo(opened.output.name, opened.output.size, refresh_hz, latency_s)
        return self._info

    def show(self, image: NDArray[np.uint8]) -> Flip | None:
        """Show an (H, W, 3) uint8 image until the next call; return when it is displayed.

        Returns:
            Its flip; None where the image is not displayed yet, with the reason from :meth:`problem`.
        """
        return self.show_sequence([image])

    def show_sequence(
        self, images: list[NDArray[np.uint8]], *, hold_frames: int = 1, loop: bool = False
    ) -> Flip | None:
        """Show images one after the other; return the flip of the first when it is displayed.

        Args:
            images: at most 64 of (H, W, 3) uint8.
            hold_frames: vertical blanks that each stays; loop: whether to repeat; else the last one stays.

        Raises:
            SettingRefused: images of another size, or too many. DriverError: the projector is closed.
        """
        if self._supervisor is None or self._info is None:
            raise DriverError("projector: show() while closed; open() comes first")
        if not 1 <= len(images) <= SEQUENCE_LIMIT or hold_frames < 1:
            raise SettingRefused(
                f"projector: {len(images)} images, {hold_frames} frames; expected 1 to {SEQUENCE_LIMIT}, at least 1"
            )
        width, height = self._info.size
        for image in images:
            if image.shape != (height, width, 3) or image.dtype != np.uint8:
                raise SettingRefused(
                    f"projector: image {image.shape} {image.dtype} does not fit output {self._info.output}, "
                    f"expected {(height, width, 3)} uint8"
                )
        if sum(image.nbytes for image in images) > BYTES_LIMIT:
            raise SettingRefused(f"projector: the images are larger than {BYTES_LIMIT >> 20} MiB together; show fewer")
        hook = self.options.hook
        timeout_s = self.options.show_timeout_s + len(hook.show) * hook.timeout_s
        shown = self._supervisor.show(images, hold_frames=hold_frames, loop=loop, timeout_s=timeout_s)
        self._last_flip = self._flip(shown)
        return self._last_flip

    def problem(self) -> str:
        """Return why the last image may not be displayed now, empty when it is."""
        if self._supervisor is None:
            return "the projector is closed"
        problem = self._supervisor.problem()
        return f"projector {self.options.output}: {problem}" if problem else ""

    def close(self) -> None:
        """Go dark, release the output, run the hooks; never raises, may be called twice."""
        if self._supervisor is None:
            return
        self._supervisor.close()
        self._supervisor = self._info = None
        try:
            self._run_hooks(self.options.hook.close)
        except DriverError as error:
            self.notes = (*self.notes, str(error))

    @property
    def counted(self) -> dict[str, int]:
        """``restarts`` of the window and ``late`` images of sequences since it was opened."""
        return self._supervisor.counted() if self._supervisor is not None else {"restarts": 0, "late": 0}

    @property
    def window_pid(self) -> int:
        """Process id of the window, 0 while there is none."""
        return self._supervisor.pid if self._supervisor is not None else 0

    @property
    def measured_refresh_hz(self) -> float | None:
        """Refresh rate between the first and the last flip, None if the server reports no vertical blanks."""
        first, last = self._first_flip, self._last_flip
        if first is None or last is None or not 0 < first.msc < last.msc:
            return None
        return (last.msc - first.msc) * 1e9 / (last.t_monotonic_ns - first.t_monotonic_ns)

    def _flip(self, shown: Shown | None) -> Flip | None:
        if shown is None:
            return None
        offset_ns = time.time_ns() - time.monotonic_ns()
        flip = Flip(shown.t_monotonic_ns, shown.t_monotonic_ns + offset_ns, shown.msc, shown.source)
        if self._first_flip is None or flip.msc <= self._first_flip.msc:
            self._first_flip = flip
        return flip

    def _after_show(self) -> None:
        self._run_hooks(self.options.hook.show)

    def _run_hooks(self, commands: tuple[tuple[str, ...], ...]) -> None:
        variables = {"FRINGED_OUTPUT": self.options.output}
        run_hooks(commands, timeout_s=self.options.hook.timeout_s, directory=self._directory, variables=variables)
