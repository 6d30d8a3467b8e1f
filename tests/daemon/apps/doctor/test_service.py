"""Findings of the doctor about an installed service."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.apps.doctor.finding import Finding
from daemon.apps.doctor.host import service
from daemon.apps.doctor.machine import Machine
from daemon.apps.doctor.subject import Subject
from daemon.apps.install import steps
from daemon.apps.install.environment import Source, default_python
from daemon.apps.install.target import Target
from tests.daemon.apps.install.test_steps import as_root
from tests.daemon.apps.install.test_units import needs_systemd
from tests.daemon.bootstrap.systemd.manager import PATIENT

pytestmark = PATIENT


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    needs_systemd()
    root = tmp_path_factory.mktemp("image")
    source = Source(default_python(), shared=True)
    steps.install(Target(root), source, steps.InstallOptions(compile=False), lambda _: None)
    return root


def found(root: Path) -> dict[str, Finding]:
    return {finding.name: finding for finding in service.check(Subject(Machine(root, {})))}


def test_without_an_installation_there_is_one_note(tmp_path: Path) -> None:
    (finding,) = found(tmp_path).values()
    assert finding.level == "note" and "not installed" in finding.text


@as_root
def test_a_fresh_installation_has_no_problem(image: Path) -> None:
    assert {name: finding.level for name, finding in found(image).items()} == dict.fromkeys(
        ("program", "groups", "rights"), "ok"
    )


@as_root
def test_changed_permissions_are_reported_with_the_command_that_restores_them(image: Path) -> None:
    takes = image / "var/lib/fringed/takes"
    takes.chmod(0o777)
    finding = found(image)["rights"]
    takes.chmod(0o750)
    assert finding.level == "warning"
    assert finding.remedy.endswith("sudo chmod 0750 /var/lib/fringed/takes")
    assert found(image)["rights"].level == "ok"


@as_root
def test_a_missing_group_and_a_missing_program_are_reported(image: Path) -> None:
    groups, link = image / "etc/group", image / "opt/fringed/env"
    before, to = groups.read_text(), link.readlink()
    groups.write_text("\n".join(line for line in before.splitlines() if not line.startswith("plugdev:")))
    link.unlink()
    findings = found(image)
    groups.write_text(before)
    link.symlink_to(to)
    assert findings["groups"].level == "warning" and "usermod -aG plugdev fringed" in findings["groups"].remedy
    assert findings["program"].level == "problem" and "env/bin/python" in findings["program"].text
