"""The rig.yaml: all its errors, including those in the drivers' options."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from pydantic import ValidationError

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject, options_parser
from daemon.common.errors import ConfigError
from daemon.config.checks import UNCALIBRATED
from daemon.config.load import load_rig
from daemon.config.rig_config import RigConfig
from daemon.config.yaml_source import read_yaml
from daemon.rig.open_rig import OptionsError
from drivers.protocols import SIDES

area = Area("rig")


def read_leniently(path: Path) -> tuple[RigConfig | None, list[str]]:
    """The rig, if it can be parsed, and all errors.

    Some errors, such as a missing file, do not prevent the checks of the cameras.
    """
    try:
        return load_rig(path), []
    except ConfigError as error:
        problems = error.problems
    except OSError as error:
        return None, [f"{path}: {error.strerror or error}"]
    try:
        source = read_yaml(path.read_text(encoding="utf-8"))
        return RigConfig.model_validate_json(json.dumps(source.data)), problems
    except (ValidationError, ValueError, OSError):
        return None, problems


def check(subject: Subject) -> Iterator[Finding]:
    """Report the errors, or a summary of the rig."""
    if subject.path is None:
        return
    _, problems = read_leniently(subject.path)
    remedy = f"change that line of {subject.path.name}; see: fringed check {subject.path}"
    if not subject.path.is_file():
        remedy = "give an existing rig.yaml; examples/rig.yaml is a template"
    missing = [text.split()[1] for text in problems if text.endswith(UNCALIBRATED)]
    for text in problems:
        if not text.endswith(UNCALIBRATED):
            yield area.problem("file", text, remedy)
    if missing:
        text = f"not calibrated yet: {subject.path.name} has no {', no '.join(missing)}"
        yield area.problem("calibration", text, f"fringed calibrate all {subject.path}; then name its file there")
    config = subject.config
    if config is None:
        yield area.note("file", "the other checks run as without a rig.yaml")
        return
    wrong = list(option_problems(subject))
    for text in wrong:
        located = OptionsError("cameras", text).located(subject.path)
        yield area.problem("options", str(located), f"change that option in {subject.path.name}")
    if not problems and not wrong:
        names = [f"cameras by {config.cameras.driver}"]
        names += [f"projector by {config.projector.driver}"] if config.projector is not None else []
        yield area.ok("file", f"{config.device.name}: {', '.join(names)}")


def option_problems(subject: Subject) -> Iterator[str]:
    """Errors that the drivers report about their options."""
    config = subject.config
    if config is None:
        return
    if config.cameras.driver in ("genicam", "v4l2"):
        parse = options_parser(config.cameras.driver)
        for side in SIDES:
            try:
                parse(side, subject.options(side))
            except ValueError as error:
                yield str(error)
    if config.cameras.driver == "sim":
        from sim.devices.options import from_mapping

        try:
            from_mapping(dict(config.simulation), subject.base_dir)
        except (ValueError, TypeError) as error:
            yield str(error)
    if config.projector is not None and config.projector.driver in ("x11", "external"):
        from drivers.projector.options import ExternalOptions, ProjectorOptions, read

        try:
            if config.projector.driver == "x11":
                read(ProjectorOptions, config.projector.options)
            else:
                read(ExternalOptions, config.projector.options)
        except ValueError as error:
            yield str(error)
