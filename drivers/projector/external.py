"""A projector that shows its image by itself: from its flash memory, or driven by another program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError, SettingRefused
from drivers.projector.hooks import run_hooks
from drivers.projector.options import ExternalOptions
from drivers.protocols import ProjectorInfo


class ExternalProjector:
    """Shows nothing itself: it checks sizes and runs hooks; what :meth:`show` is given never reaches the projector.

    Args:
        options: see :class:`drivers.projector.options.ExternalOptions`; directory: of the hooks.
    """

    def __init__(self, options: ExternalOptions, directory: Path) -> None:
        self.options = options
        self.notes: tuple[str, ...] = ("the image of an external projector cannot be verified",)
        self._directory = directory
        self._open = False
        self._problem = ""

    def open(self) -> ProjectorInfo:
        """Run the ``open`` hooks; DriverError if one fails."""
        if not self._open:
            self._run_hooks(self.options.hook.open)
            self._open, self._problem = True, ""
        refresh_hz = self.options.refresh_hz
        latency_s = self.options.latency_s(refresh_hz)
        return ProjectorInfo(self.options.name, self.options.size, refresh_hz, latency_s, fixed_image=True)

    def show(self, image: NDArray[np.uint8]) -> None:
        """Run the ``show`` hooks; :meth:`problem` names a hook that failed."""
        if not self._open:
            raise DriverError(f"projector {self.options.name}: show() while closed; open() comes first")
        width, height = self.options.size
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise SettingRefused(
                f"projector {self.options.name}: image {image.shape} {image.dtype} does not fit, "
                f"expected {(height, width, 3)} uint8 (projector.options.size)"
            )
        try:
            self._run_hooks(self.options.hook.show)
            self._problem = ""
        except DriverError as error:
            self._problem = str(error)

    def problem(self) -> str:
        """Return the error of the last hook, empty if there is none."""
        return self._problem if self._open else f"projector {self.options.name} is closed"

    def close(self) -> None:
        """Run the ``close`` hooks; never raises, may be called twice."""
        if not self._open:
            return
        self._open = False
        try:
            self._run_hooks(self.options.hook.close)
        except DriverError as error:
            self.notes = (*self.notes, str(error))

    def _run_hooks(self, commands: tuple[tuple[str, ...], ...]) -> None:
        variables = {"FRINGED_OUTPUT": self.options.name}
        run_hooks(commands, timeout_s=self.options.hook.timeout_s, directory=self._directory, variables=variables)
