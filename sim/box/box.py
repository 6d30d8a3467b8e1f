"""A complete rig without hardware: X server, emulated cameras, the light between them, and the rig's files."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from drivers.protocols import SIDES, Side
from sim.box.exposure_ledger import Ledger
from sim.box.options import BoxOptions
from sim.box.output_grabber import Grabber
from sim.box.rig_files import PIXEL_FORMATS, RigAddresses, write_rig
from sim.box.world import World
from sim.box.xserver import Head, XServer
from sim.devices.scene_options import scene_of
from sim.gentl.build import build
from sim.gentl.cable import Cable, Filter
from sim.render.projection_transport import Stage

GENTL_DIR = "FRINGED_GENTL_DIR"
OUTPUT = "DUMMY1"
_DESKTOP = Head(640, 480)
_FILTERS: dict[str, Filter] = {
    "rgb8": "RG",
    "bayer_rggb8": "RG",
    "bayer_bggr8": "BG",
    "bayer_grbg8": "GR",
    "bayer_gbrg8": "GB",
    "mono8": "mono",
    "mono16": "mono",
}
# Added to exposure and readout, so that no edge meets a busy sensor because of rounding.
_REST_S = 0.0005


class Box:
    """All of a rig but the daemon; a context manager.

    Args:
        options: of the box.
        real_time: frames leave the cameras exposure and readout after the edge; False = at once, for lock-step.
        ledger: of the world.

    Attributes:
        server: the box's X server, None when it uses another one. display: of the X server whose output ``OUTPUT`` is
            the projector. cables: to the cameras. world: triggers the cameras.
        stage: the scene. rig_file: for ``fringed run``. gentl_dir: value of the environment variable ``GENTL_DIR``
            for every process that opens the cameras.
    """

    def __init__(self, options: BoxOptions, *, real_time: bool = True, ledger: Ledger | None = None) -> None:
        self.options = options
        self._real_time, self._ledger = real_time, ledger
        self._stack = ExitStack()

    def __enter__(self) -> Box:
        with ExitStack() as stack:
            self._make(stack)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def serials(self) -> dict[Side, str]:
        """Serial numbers of the cameras."""
        return {side: f"BOX-{side.upper()}" for side in SIDES}

    def _make(self, stack: ExitStack) -> None:
        options = self.options
        simulation, layout = options.simulation, options.layout
        folder = options.folder
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fringed-box-")))
        self.folder, self.gentl_dir = folder, folder / "gentl"
        self.gentl_dir.mkdir(parents=True, exist_ok=True)
        producer = build()
        scene = scene_of(simulation)
        self.stage = Stage(
            layout, scene, simulation.optics, encoding=simulation.encoding, instants_s=options.instants_s
        )
        self.server: XServer | None = None
        if not options.display:
            self.server = stack.enter_context(XServer(heads(options)))
        self.display = self.server.display if self.server else options.display
        self.cables: Mapping[Side, Cable] = {
            side: stack.enter_context(self._cable(number, side)) for number, side in enumerate(SIDES)
        }
        for side in SIDES:
            self.cables[side].set_clock(drift_ppm=options.drift_ppm[side])
        self.grabber = stack.enter_context(Grabber(self.display, OUTPUT))
        self.world = World(
            self.grabber,
            self.stage,
            self.cables,
            size=layout.projector_size,
            instants=len(self.stage.instants_s),
            plan=simulation.faults,
            period_s=(options.exposure_us + options.readout_us) / 1e6 + _REST_S,
            ledger=self._ledger,
        )
        self.rig_file = write_rig(
            folder,
            layout,
            simulation.optics,
            RigAddresses(producer, self.serials, self.display, OUTPUT),
            pixel_format=PIXEL_FORMATS[simulation.encoding],
            exposure_us=options.exposure_us,
            tolerance_us=options.tolerance_us,
            tcp=options.tcp,
        )

    def _cable(self, number: int, side: Side) -> Cable:
        options = self.options
        return Cable(
            self.gentl_dir,
            number,
            serial=self.serials[side],
            size=options.layout.camera_size,
            sensor=_FILTERS[options.simulation.encoding],
            real_time=self._real_time,
            readout_us=options.readout_us,
        )


def heads(options: BoxOptions) -> tuple[Head, Head]:
    """Outputs of the box's X server: a small desktop, and the projector."""
    return _DESKTOP, Head(*options.layout.projector_size)
