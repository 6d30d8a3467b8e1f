"""Calibration, pattern and volume: readable, of one piece, and made for these cameras and this projector."""

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
from drivers.projector.found import find
from drivers.protocols import SIDES, ProjectorInfo
from pipeline.calibrate.bundle.quality.order_check import order_check
from pipeline.common.errors import PipelineError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.color_fringe import from_mapping as pattern_from_mapping
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

area = Area("calibration")

OLD_DAYS = 90
_SEEN_LEAST = 0.3
_AGAIN = "calibrate again, or name the right file in rig.yaml"


def check(subject: Subject) -> Iterator[Finding]:
    """The three files, each by itself and against the devices."""
    config = subject.config
    if config is None:
        yield area.note("files", "not looked at: rig.yaml cannot be read")
        return
    try:
        file = subject.calibration
    except (PipelineError, OSError) as error:
        yield area.problem("file", str(error), _AGAIN)
        file = None
    if config.calibration is None:
        yield area.ok("file", "the simulated rig knows its own calibration, pattern and volume")
    if file is not None:
        yield described(file)
        yield age(file)
        yield from cameras(subject, file)
    try:
        yield from pattern(subject, config)
        if file is not None:
            yield from volume(subject, config, file.calibration)
            yield from layout(subject, config, file.calibration)
    except (PipelineError, DaemonError, OSError) as error:
        yield area.problem("pattern or volume", str(error), "correct that file, or name the right one in rig.yaml")


def described(file: CalibrationFile) -> Finding:
    """What it is."""
    left, baseline = file.calibration.left.size, file.calibration.baseline_mm
    return area.ok("file", f"cameras {left[0]}x{left[1]}, baseline {baseline:.1f} mm, {file.identity[:19]}...")


def age(file: CalibrationFile, now_s: float | None = None) -> Finding:
    """How old it is by its own date."""
    stamp = created_at(file.mapping)
    if stamp is None:
        return area.note("age", "it does not tell when it was made")
    days = ((time.time() if now_s is None else now_s) - stamp.timestamp()) / 86400
    if days > OLD_DAYS:
        text = f"made {days:.0f} days ago; rigs move with temperature and time"
        return area.warning("age", text, "measure a known object, and calibrate again if it is off")
    return area.ok("age", f"made {max(days, 0):.0f} days ago")


def cameras(subject: Subject, file: CalibrationFile) -> Iterator[Finding]:
    """Sizes, and serial numbers where the file has them, against rig.yaml and the cameras that are seen."""
    for side in SIDES:
        size = data_rate.image_size(subject, side)
        problem = size_problem(side, size, file.calibration) if size is not None else ""
        if problem:
            yield area.problem(f"camera {side}", *_split(problem))
        made_with = serial_in(file.mapping, side)
        options = subject.cameras.get(side)
        serial = getattr(options, "serial", None)
        if made_with and serial and made_with != serial:
            text = f"camera {side} is {serial}, the calibration was made with {made_with}"
            yield area.problem(f"camera {side}", text, _AGAIN)


def serial_in(mapping: Mapping[str, Any], side: str) -> str:
    """The serial number that a calibration names for a camera, empty if it names none."""
    place: Any = mapping
    for key in ("cameras", side, "serial"):
        place = place.get(key) if isinstance(place, Mapping) else None
    return str(place) if place is not None else ""


def pattern(subject: Subject, config: RigConfig) -> Iterator[Finding]:
    """The pattern against the projector."""
    made = pattern_of(subject, config)
    if made is None:
        return
    projector = projector_of(subject)
    problem = projector_problem(projector, made) if projector is not None else ""
    if problem:
        yield area.problem("pattern", *_split(problem))
    else:
        fit = f", as {projector.output} shows" if projector is not None else ""
        yield area.ok("pattern", f"{made.periods:g} periods along {made.axis}, {made.size[0]}x{made.size[1]}{fit}")


def pattern_of(subject: Subject, config: RigConfig) -> ColorFringe | None:
    """The pattern that rig.yaml names or holds."""
    if config.pattern is None:
        return None
    if isinstance(config.pattern, str):
        return read_pattern(config.path(config.pattern, subject.base_dir))
    return pattern_from_mapping(config.pattern)


def volume_of(subject: Subject, config: RigConfig) -> Volume | None:
    """The measuring volume that rig.yaml names or holds."""
    if config.volume is None:
        return None
    if isinstance(config.volume, str):
        return read_volume(config.path(config.volume, subject.base_dir))
    return Volume(config.volume.near_mm, config.volume.far_mm)


def projector_of(subject: Subject) -> ProjectorInfo | None:
    """The projector as far as it is known without opening it."""
    options = subject.projector
    if options is None:
        return None
    size = options.size
    if subject.uses("x11"):
        try:
            output = find(subject.outputs, options.output)
        except DriverError:
            output = None
        size = output.size if output is not None and output.lit else size
    name = options.output if subject.uses("x11") else options.name
    return ProjectorInfo(name, tuple(size), 0.0) if size is not None else None


def volume(subject: Subject, config: RigConfig, calibration: Calibration) -> Iterator[Finding]:
    """The volume against what the right camera and the projector see of it."""
    made = volume_of(subject, config)
    if made is None:
        return
    parts = {depth: seen(calibration, depth) for depth in (made.near_mm, made.far_mm)}
    text = f"{made.near_mm:g} to {made.far_mm:g} mm; of the left image all three see "
    text += " and ".join(f"{100 * part:.0f} % at {depth:g} mm" for depth, part in parts.items())
    if min(parts.values()) < _SEEN_LEAST:
        yield area.warning("volume", text, "set volume.near_mm and far_mm to where both cameras and the projector look")
    else:
        yield area.ok("volume", text)


def layout(subject: Subject, config: RigConfig, calibration: Calibration) -> Iterator[Finding]:
    """Whether the projector stands where the cameras can tell fringe orders apart."""
    made, fringe = volume_of(subject, config), pattern_of(subject, config)
    if made is None or fringe is None:
        return
    found = order_check(calibration, made, periods=fringe.periods, axis=fringe.axis)
    if found.good or fringe.profile is not None:
        yield area.ok("layout", found.recommendation)
    else:
        yield area.warning("layout", *_split(found.recommendation))


def seen(calibration: Calibration, depth_mm: float) -> float:
    """The part of the left image that the right camera and the projector see too, if all lay at that depth."""
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
    what, _, remedy = problem.partition("; ")
    return what, remedy or _AGAIN
