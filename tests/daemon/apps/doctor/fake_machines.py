"""Fake machines: files of /proc, /sys, /dev and /etc, and their rigs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from daemon.apps.doctor.finding import Finding
from daemon.apps.doctor.machine import Machine
from daemon.apps.doctor.subject import Subject
from daemon.config import parse_rig
from tests.daemon.rigs import devices


def machine(root: Path, files: Mapping[str, str] | None = None, environ: Mapping[str, str] | None = None) -> Machine:
    """A machine whose files contain these texts."""
    for name, text in (files or {}).items():
        path = root / name.lstrip("/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return Machine(root, dict(environ or {}))


def subject(
    root: Path, files: Mapping[str, str] | None = None, rig: str = "", environ: Mapping[str, str] | None = None
) -> Subject:
    """Such a machine, with a rig if ``rig`` is given."""
    fake = machine(root, files, environ)
    if not rig:
        return Subject(fake)
    path = root / "rig.yaml"
    path.write_text(rig)
    return Subject(fake, path, parse_rig(rig, base_dir=root))


def write_rig_files(directory: Path) -> None:
    """Write calibration, pattern and volume of the simulated rig."""
    rig = devices()
    try:
        (directory / "calibration.yaml").write_text(yaml.safe_dump(dict(rig.calibration)))
        (directory / "pattern.json").write_text(json.dumps(dict(rig.pattern), default=list))
        (directory / "volume.json").write_text(json.dumps(dict(rig.volume)))
    finally:
        rig.close()


FILES = "calibration: calibration.yaml\npattern: pattern.json\nvolume: volume.json\n"


def genicam(left: str = "{serial: A1}", right: str = "{serial: A2}", more: str = "") -> str:
    """A rig of GenICam cameras and an external projector."""
    return (
        f"cameras: {{driver: genicam, left: {left}, right: {right}}}\n"
        "projector: {driver: external, options: {size: [160, 128], refresh_hz: 60.0}}\n" + FILES + more
    )


def v4l2(pixel_format: str) -> str:
    """The same of V4L2 cameras."""
    side = f"{{device: /dev/video%d, size: [128, 102], format: {pixel_format}}}"
    return genicam(side % 0, side % 1).replace("driver: genicam", "driver: v4l2")


def by_name(findings: Any, name: str) -> list[Finding]:
    """The findings of a name."""
    return [finding for finding in findings if finding.name == name]


def levels(findings: Any) -> list[str]:
    return [finding.level for finding in findings]
