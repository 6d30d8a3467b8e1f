"""``fringed check``: check a rig.yaml, a calibration, a pattern, a volume or a take."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from daemon.config.rig_config import RigConfig

_KEY = re.compile(r"(?:cameras|projector|fringed_calibration)(?:\.\w+)*")


def main(
    files: Annotated[list[Path], typer.Argument(help="rig.yaml, calibration.yaml, pattern.json, volume.json, takes.")],
) -> None:
    """Check files of a rig; errors are printed with their position, and the exit status is 1 if there is one."""
    results = [check_file(path) for path in files]
    for path, (good, lines) in zip(files, results, strict=True):
        for line in lines:
            typer.echo(line, err=not good)
        if good and not lines:
            typer.echo(f"{path}: good")
    if not all(good for good, _ in results):
        raise typer.Exit(1)


def check_file(path: Path) -> tuple[bool, list[str]]:
    """Whether a file is valid, and its errors or a summary."""
    from daemon.common.errors import ConfigError, DaemonError
    from pipeline.common.errors import PipelineError

    try:
        return _checker(path)(path)
    except ConfigError as error:
        return False, error.problems
    except (DaemonError, PipelineError) as error:
        return False, [str(error)]
    except OSError as error:
        return False, [f"{path}: {error.strerror or error}"]


def _checker(path: Path) -> Callable[[Path], tuple[bool, list[str]]]:
    """The check for a file, by its content and name."""
    if path.is_dir() or path.name.removesuffix(".partial").endswith(".mcap"):
        return _take
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"\x89MCAP"):
        return _take
    if path.suffix == ".json" or head.lstrip()[:1] == b"{":
        return _volume if b'"near_mm"' in head else _pattern
    return _calibration if b"fringed_calibration" in head or path.stem == "calibration" else _rig


def _rig(path: Path) -> tuple[bool, list[str]]:
    from daemon.config import load_rig
    from daemon.rig.open_rig import OptionsError, check_options

    config = load_rig(path)
    try:
        check_options(config, path.resolve().parent)
    except OptionsError as error:
        raise error.located(path) from error
    lines = [f"{path}: good: rig {config.device.name}, cameras by {config.cameras.driver}"]
    problems: list[str] = []
    for name in (config.calibration, config.pattern, config.volume):
        if isinstance(name, str):  # the files that it names are checked too
            good, messages = check_file(config.path(name, path.parent))
            (lines if good else problems).extend(messages)
    if not problems and config.calibration is not None:
        _check_volume(config, path)
    return not problems, problems or lines


def _check_volume(config: RigConfig, path: Path) -> None:
    """Raise CalibrationError where volume and calibration of a rig cannot belong together."""
    from daemon.rig.calibration_file import read_calibration
    from daemon.rig.pattern_file import read_volume
    from pipeline.rig.plausibility import check_volume
    from pipeline.rig.volume import Volume

    if config.volume is None or config.calibration is None:
        return
    calibration = read_calibration(config.path(config.calibration, path.parent)).calibration
    volume = (
        read_volume(config.path(config.volume, path.parent))
        if isinstance(config.volume, str)
        else Volume(config.volume.near_mm, config.volume.far_mm)
    )
    check_volume(calibration.left, calibration.right, volume)


def _calibration(path: Path) -> tuple[bool, list[str]]:
    from daemon.rig.calibration_file import read_calibration
    from pipeline.common.errors import CalibrationError

    try:
        file = read_calibration(path)
    except CalibrationError as error:
        return False, [_with_line(path, str(error))]
    left = file.calibration.left.size
    baseline = file.calibration.baseline_mm
    return True, [
        f"{path}: good: cameras {left[0]} x {left[1]}, baseline {baseline:.1f} mm, {file.identity}",
        f"{path}: checked: keys, sizes, focal lengths, principal points, distortion, rotations, distances and angles "
        "between the devices; not checked: whether the rig is still as calibrated (fringed calibrate check)",
    ]


def _with_line(path: Path, message: str) -> str:
    """Add the line of the key in a message, or of the nearest enclosing key."""
    from daemon.config.yaml_source import read_yaml

    text = message.removeprefix(f"{path}: ")
    key = _KEY.match(text)
    if text == message or key is None:
        return message
    line, column = read_yaml(path.read_text(encoding="utf-8")).position(tuple(key.group().split(".")), key=True)
    return f"{path}:{line}:{column}: {text}"


def _pattern(path: Path) -> tuple[bool, list[str]]:
    from daemon.rig.pattern_file import read_pattern

    pattern = read_pattern(path)
    return True, [
        f"{path}: good: {pattern.periods:g} periods along {pattern.axis}, {pattern.size[0]} x {pattern.size[1]}"
    ]


def _volume(path: Path) -> tuple[bool, list[str]]:
    from daemon.rig.pattern_file import read_volume

    volume = read_volume(path)
    return True, [f"{path}: good: {volume.near_mm:g} to {volume.far_mm:g} mm"]


def _take(path: Path) -> tuple[bool, list[str]]:
    from daemon.recording.read.inspect import inspect
    from daemon.recording.read.take_reader import TakeReader

    with TakeReader(path) as take:
        report = inspect(take)
    problems: list[str] = report["problems"] + report["attachment_problems"]
    return not problems, problems or [f"{path}: good: {report['pairs']} pairs"]
