"""The doctor reports files of a rig that other users can change, and unusable keys."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.apps.doctor.host.file_permissions import check
from daemon.apps.doctor.machine import Machine
from daemon.apps.doctor.subject import Subject
from daemon.config import parse_rig
from daemon.keys.key_store import KeyStore

RIG = "cameras: {driver: sim}\nsecurity: {keys: keys}\n"


@pytest.fixture
def subject(tmp_path: Path) -> Subject:
    KeyStore(tmp_path / "keys").make_server()
    (tmp_path / "takes").mkdir(mode=0o755)
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    path.chmod(0o644)
    return Subject(Machine(), path, parse_rig(RIG, base_dir=tmp_path))


def found(subject: Subject) -> dict[str, str]:
    return {finding.name: finding.level for finding in check(subject)}


def test_a_rig_with_correct_permissions_is_ok(subject: Subject) -> None:
    assert found(subject) == {"rig file": "ok", "takes": "ok", "keys": "ok"}


@pytest.mark.parametrize(("name", "path"), [("rig file", "rig.yaml"), ("takes", "takes")])
def test_world_writable_files_are_reported(subject: Subject, name: str, path: str) -> None:
    (subject.base_dir / path).chmod(0o777)
    assert found(subject)[name] == "warning"


def test_keys_that_others_can_read_or_change_are_a_problem(subject: Subject) -> None:
    secret = subject.base_dir / "keys" / "server.key"
    secret.chmod(0o644)
    assert found(subject)["keys"] == "problem"
    secret.chmod(0o600)
    assert found(subject)["keys"] == "ok"
