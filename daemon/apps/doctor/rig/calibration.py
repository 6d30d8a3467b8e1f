"""Calibration, pattern and volume: readable, consistent, and made for these cameras and this projector."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.errors import DaemonError
from daemon.config.rig_config import RigConfig
from daemon.live.compatibility import projector_problem, size_problem
from daemon.rig.calibration_file import CalibrationFile, created_at
from daemon.rig.pattern_file import read_pattern, read_volume
from drivers.errors import DriverError
from drivers.genicam.options import Options as GenicamOptions
from drivers.projector.options import ExternalOptions
from drivers.projector.x11.detected_output import find_output
from drivers.protocols import SIDES, ProjectorInfo
from pipeline.common.errors import PipelineError
from pipeline.monitor.hidden_turn import hidden_turn
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.color_fringe import from_mapping as pattern_from_mapping
from pipeline.pattern.fringe_width import width_warnings
from pipeline.pattern.order_check import order_check
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

area = Area("calibration")

OLD_DAYS = 90
_LEAST_COMMON_VIEW = 0.3
_RECALIBRATE = "calibrate again, or name the right file in rig.yaml"


def check(subject: Subject) -> Iterator[Finding]:
    """Check the three files, individually and against the devices."""
    config = subject.config
    if config is None:
        yield area.note("files", "not checked: rig.yaml is unreadable")
        return
    try:
        file = subject.calibration
    except (PipelineError, OSError) as error:
        yield area.problem("file", str(error), _RECALIBRATE)
        file = None
    if config.calibration is None and subject.uses("sim"):
        yield area.ok("file", "the simulated rig has its own calibration, pattern and volume")
    elif config.calibration is None:
        yield area.note("file", "not checked: the rig is not calibrated yet")
    if file is not None:
        yield summary(file)
        yield age(file)
        yield from cameras(subject, file)
    try:
        yield from pattern(subject, config, file)
        if file is not None:
            yield from volume(subject, config, file.calibration)
            yield from layout(subject, config, file.calibration)
    except (PipelineError, DaemonError, OSError) as error:
        yield area.problem("pattern or volume", str(error), "correct that file, or name the right one in rig.yaml")


def summary(file: CalibrationFile) -> Finding:
    """Summarise the calibration."""
    left, baseline = file.calibration.left.size, file.calibration.baseline_mm
    return area.ok("file", f"cameras {left[0]}x{left[1]}, baseline {baseline:.1f} mm, {file.identity[:19]}...")


def age(file: CalibrationFile, now_s: float | None = None) -> Finding:
    """Check the age of the calibration."""
    stamp = created_at(file.mapping)
    if stamp is None:
        return area.note("age", "it contains no date")
    days = ((time.time() if now_s is None else now_s) - stamp.timestamp()) / 86400
    if days > OLD_DAYS:
        text = f"made {days:.0f} days ago; rigs drift with temperature and time"
        return area.warning("age", text, "measure a known object, and calibrate again if its size is wrong")
    return area.ok("age", f"made {max(days, 0):.0f} days ago")


def cameras(subject: Subject, file: CalibrationFile) -> Iterator[Finding]:
    """Compare image sizes, and the serial numbers in the file, with rig.yaml and the cameras."""
    for side in SIDES:
        size = data_rate.image_size(subject, side)
        problem = size_problem(side, size, file.calibration) if size is not None else ""
        if problem:
            yield area.problem(f"camera {side}", *_split(problem))
        made_with = serial_in(file.mapping, side)
        options = subject.cameras.get(side)
        serial = options.serial if isinstance(options, GenicamOptions) else None
        if made_with and serial and made_with != serial:
            text = f"camera {side} is {serial}, the calibration was made with {made_with}"
            yield area.problem(f"camera {side}", text, _RECALIBRATE)


def serial_in(mapping: Mapping[str, Any], side: str) -> str:
    """A camera's serial number in a calibration, empty without one."""
    value: Any = mapping
    for key in ("cameras", side, "serial"):
        value = value.get(key) if isinstance(value, Mapping) else None
    return str(value) if value is not None else ""


def pattern(subject: Subject, config: RigConfig, file: CalibrationFile | None) -> Iterator[Finding]:
    """Compare the pattern with the projector, and with the one that was calibrated."""
    fringe = pattern_of(subject, config)
    if fringe is None:
        return
    projector = projector_of(subject)
    problem = projector_problem(projector, fringe) if projector is not None else ""
    if file is not None and fringe.size != file.calibration.projector.size:
        calibrated = list(file.calibration.projector.size)
        text = f"pattern.size {list(fringe.size)} is not the size of the calibrated projector, {calibrated}"
        yield area.problem("pattern", text, f"set pattern.size to {calibrated}, or calibrate with this projector")
    elif problem:
        yield area.problem("pattern", *_split(problem))
    else:
        fit = f", the size of {projector.output}" if projector is not None else ""
        yield area.ok(
            "pattern", f"{fringe.periods:g} periods along {fringe.axis}, {fringe.size[0]}x{fringe.size[1]}{fit}"
        )


def pattern_of(subject: Subject, config: RigConfig) -> ColorFringe | None:
    """The pattern that rig.yaml names or contains."""
    if config.pattern is None:
        return None
    if isinstance(config.pattern, str):
        return read_pattern(config.path(config.pattern, subject.base_dir))
    return pattern_from_mapping(config.pattern)


def volume_of(subject: Subject, config: RigConfig) -> Volume | None:
    """The measuring volume that rig.yaml names or contains."""
    if config.volume is None:
        return None
    if isinstance(config.volume, str):
        return read_volume(config.path(config.volume, subject.base_dir))
    return Volume(config.volume.near_mm, config.volume.far_mm)


def projector_of(subject: Subject) -> ProjectorInfo | None:
    """The projector's properties that are known without opening it."""
    options = subject.projector
    if options is None:
        return None
    if isinstance(options, ExternalOptions):
        return ProjectorInfo(options.name, options.size, 0.0)
    try:
        output = find_output(subject.outputs, options.output)
    except DriverError:
        output = None
    size = output.size if output is not None and output.is_on else options.size
    return ProjectorInfo(options.output, size, 0.0) if size is not None else None


def volume(subject: Subject, config: RigConfig, calibration: Calibration) -> Iterator[Finding]:
    """Compare the volume with the common field of view of both cameras and the projector."""
    space = volume_of(subject, config)
    if space is None:
        return
    parts = {depth: common_view(calibration, depth) for depth in (space.near_mm, space.far_mm)}
    text = f"{space.near_mm:g} to {space.far_mm:g} mm; common to all devices of the left image: "
    text += " and ".join(f"{100 * part:.0f} % at {depth:g} mm" for depth, part in parts.items())
    if min(parts.values()) < _LEAST_COMMON_VIEW:
        yield area.warning(
            "volume", text, "set volume.near_mm and far_mm to the depths that both cameras and the projector cover"
        )
    else:
        yield area.ok("volume", text)


def layout(subject: Subject, config: RigConfig, calibration: Calibration) -> Iterator[Finding]:
    """Check whether layout and fringes allow to distinguish orders, and to notice a turned camera."""
    space, fringe = volume_of(subject, config), pattern_of(subject, config)
    if space is None or fringe is None:
        return
    result = order_check(calibration, space, periods=fringe.periods, axis=fringe.axis)
    if result.good or fringe.profile is not None:
        yield area.ok("layout", result.recommendation)
    else:
        yield area.warning("layout", *_split(result.recommendation))
    mosaic = any(data_rate.is_mosaic(subject, side) for side in SIDES)
    for warning in width_warnings(calibration, fringe, mosaic=mosaic):
        yield area.warning("fringes", *_split(warning))
    turn = None if fringe.profile is not None else hidden_turn(calibration, fringe, space)
    if turn is not None and turn.hidden:
        yield area.warning(
            "hidden turn",
            f"if the right camera turns by {turn.degrees:.2f} degrees, every fringe order changes by one and surfaces "
            f"by {turn.depth_mm:.0f} mm, which the calibration check cannot see from a pair",
            "use a frequency-modulated fringe; after an impact measure an object of known distance",
        )


def common_view(calibration: Calibration, depth_mm: float) -> float:
    """Share of the left image that the right camera and the projector cover too, at one depth."""
    width, height = calibration.left.size
    x, y = np.meshgrid(np.linspace(0, width - 1, 17), np.linspace(0, height - 1, 17))
    rays = calibration.left.normalise(np.stack([x, y], axis=-1).reshape(-1, 2))
    world = np.column_stack([rays[:, 0] * depth_mm, rays[:, 1] * depth_mm, np.full(len(rays), depth_mm)])
    inside = np.ones(len(world), bool)
    for device in (calibration.right, calibration.projector):
        pixels = device.project(world)
        inside &= (pixels >= 0).all(axis=-1) & (pixels <= np.array(device.size) - 1).all(axis=-1)
    return float(inside.mean())


def _split(problem: str) -> tuple[str, str]:
    text, _, remedy = problem.partition("; ")
    return text, remedy or _RECALIBRATE
