"""The frame path of a running daemon: its stages connected, and their change between two pairs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping

from daemon.common import threads
from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.config.rig_config import RigConfig
from daemon.kernels.jobs import measuring_jobs
from daemon.kernels.processes import Progress, compile_kernels
from daemon.live.acquisition.camera_thread import CameraThread
from daemon.live.acquisition.locked_pairer import LockedPairer, pairing_settings
from daemon.live.items import Sink
from daemon.live.processing.cloud_reconstructor import CloudReconstructor
from daemon.live.processing.reconstructor_factory import make_reconstructor, warm_up
from daemon.live.processing.worker import Worker
from daemon.live.projection.mode_controller import ModeController
from daemon.live.router import Router
from daemon.rig.camera_serials import serial_problem
from daemon.rig.open_rig import Rig
from drivers.protocols import SIDES, Clock, Side
from fringed.parts import COMPUTED
from pipeline.common.settings import Settings
from pipeline.pattern.order_check import order_warning

log = logging.getLogger("fringed")

_CHANGE_S = 20.0
_MODE_S = 180.0  # the kernels of another mode may have to be compiled


class FramePath:
    """Everything between the cameras and the sinks; not started.

    Args:
        config, rig: at the start; :meth:`change` replaces them.
        camera_changed: called whenever the state of a camera changes.
    """

    def __init__(
        self,
        config: RigConfig,
        rig: Rig,
        sinks: Mapping[str, Sink],
        *,
        camera_changed: Callable[[], None],
        clock: Clock,
    ) -> None:
        self.config, self.rig, self._clock = config, rig, clock
        self.order_warning = order_warning(rig.calibration, rig.volume, rig.pattern)
        self.kernels, self._stopping = Progress(0, 0), False
        self.settings = Settings().with_overrides(config.pipeline.settings)
        self.drops = drops = Counters()
        self.router = router = Router(sinks, drops)
        self.worker = Worker(
            config.pipeline, emit=router.emit, drops=drops, clock=clock,
            wanted=lambda: COMPUTED & router.wanted_parts().union(self.config.outputs.parts),
        )  # fmt: skip
        self.pairer = pairer = LockedPairer(
            pairing_settings(config.pairing), paired=router.pair, unpaired=router.unpaired, drops=drops, clock=clock
        )
        self.mode_controller = ModeController(
            config, rig, emit=router.emit, measure=self.worker.offer, drops=drops,
            counter_restarts=lambda: pairer.counter_restarts, clock=clock,
        )  # fmt: skip
        router.connect(self.mode_controller, self.worker.offer)
        self.cameras: dict[Side, CameraThread] = {
            side: CameraThread(
                side,
                rig.cameras[side],
                deliver=pairer.receive,
                started=pairer.camera_restarted,
                changed=camera_changed,
                clock=clock,
            )
            for side in SIDES
        }

    def warm_reconstructor(self) -> CloudReconstructor:
        """Make a reconstructor with all kernels compiled, which takes up to a minute after an update."""
        reconstructor = self._reconstructor(self.config, self.rig, self.settings)
        self._compile(self.config)
        warm_up(reconstructor, self.config.pipeline)
        return reconstructor

    def change(self, config: RigConfig, rig: Rig, settings: Settings, commits: Iterable[Callable[[], None]]) -> None:
        """Apply all of this between two pairs, or nothing of it.

        Args:
            config, settings: checked, differing from what holds now in nothing that needs a restart.
            rig: the same devices, perhaps another calibration or volume.
            commits: quick, called between the same two pairs; see :class:`daemon.live.items.Changeable`.

        Raises:
            DaemonError: while stopping, or when the pipeline does not get to it; PipelineError.
        """
        timeout_s = _CHANGE_S if config.mode == self.mode_controller.mode else _MODE_S
        with self.mode_controller.changing(config.mode):
            self.worker.replace(lambda: self._apply(config, rig, settings, commits), timeout_s)

    def _apply(
        self, config: RigConfig, rig: Rig, settings: Settings, commits: Iterable[Callable[[], None]]
    ) -> CloudReconstructor | None:
        """In the pipeline's thread: first what can fail, then what cannot."""
        reconstructor = None
        before, after = ((c.pipeline.overload, c.pipeline.temporal_prior, c.mode) for c in (self.config, config))
        other_kernels = rig is not self.rig or before != after
        other_check = config.pipeline.calibration_check != self.config.pipeline.calibration_check
        other_check |= config.pipeline.temporal != self.config.pipeline.temporal
        if settings != self.settings or other_kernels or other_check:
            reconstructor = self._reconstructor(config, rig, settings)
            if other_kernels:
                self._compile(config)
                warm_up(reconstructor, config.pipeline)
        self.config, self.rig, self.settings = config, rig, settings
        self.order_warning = order_warning(rig.calibration, rig.volume, rig.pattern)
        self.pairer.configure(pairing_settings(config.pairing))
        self.worker.configure(config.pipeline)
        for commit in commits:
            try:
                commit()
            except Exception:  # one failure must not keep the rest from being done
                log.exception("a change failed")
        return reconstructor

    @property
    def serials(self) -> dict[Side, str]:
        """Serial numbers of the connected cameras, empty where unknown."""
        return {side: self.cameras[side].status.serial for side in SIDES}

    def end_compilation(self) -> None:
        """End a compilation within about a second: the daemon stops."""
        self._stopping = True

    def _compile(self, config: RigConfig) -> None:
        def note(progress: Progress) -> None:
            self.kernels = progress
            if self._stopping:
                raise DaemonError("the daemon is stopping; the kernels are not compiled")

        jobs = measuring_jobs(self.cameras["left"].status.encoding, config.mode)
        compile_kernels(jobs, note)

    def _reconstructor(self, config: RigConfig, rig: Rig, settings: Settings) -> CloudReconstructor:
        problem = serial_problem(rig.serials, self.serials)
        if problem:
            raise DaemonError(problem)
        encodings = [self.cameras[side].status.encoding for side in SIDES]
        return make_reconstructor(config, rig, settings, encodings, self._clock, plan=self.mode_controller.plan)


def reserve_cpus(cpus: Iterable[int]) -> frozenset[int]:
    """Keep all threads of this process off these processors, as far as there are others.

    Returns:
        The processors that the threads used before; empty where nothing was changed.
    """
    reserved, available = frozenset(cpus), threads.available()
    missing = sorted(reserved - available)
    if missing:
        raise DaemonError(f"pipeline.cpus: {missing} cannot be used, there are {sorted(available)}")
    if not reserved or not available - reserved:
        return frozenset()
    threads.pin(threads.ids(), available - reserved)
    return available
