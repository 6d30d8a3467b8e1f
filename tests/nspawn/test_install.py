"""Files of ``fringed install`` on a machine with the documented modes and owners, and their removal by uninstall."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from daemon.apps.install.layout import CONFIG_FILES, DIRECTORIES, FILES, PREFIX, PROGRAMS, RIG, UNITS, InstalledPath
from tests.nspawn.helpers import MARKS, rig
from tools.nspawn import Machine

pytestmark = MARKS

OURS = "/opt/fringed", "/etc/fringed", "/var/lib/fringed", "/var/cache/fringed", "/var/log/fringed"
PLACES = [*DIRECTORIES, *FILES.values(), *PROGRAMS.values(), InstalledPath(RIG, CONFIG_FILES.mode, "root", "fringed")]
_INSTALL = "install", "--share-packages", "--no-start", "--no-compile"


@pytest.fixture(scope="module")
def machine(container: type[Machine]) -> Iterator[Machine]:
    with container() as made:
        (made.root / "root/rig.yaml").write_text(rig())
        made.fringed(*_INSTALL, "--rig", "/root/rig.yaml")
        yield made


@pytest.fixture(scope="module")
def rights(machine: Machine) -> dict[str, str]:
    """Return mode, owner and group of every installed file, by path."""
    output = machine.run("find", *OURS, "/etc/systemd", "/etc/udev", "/etc/sysusers.d", "/etc/tmpfiles.d",
                       "-printf", "%p\t%m %u %g\n").stdout  # fmt: skip
    return dict(line.split("\t") for line in output.splitlines())


@pytest.mark.parametrize("place", PLACES, ids=lambda place: str(place.path))
def test_mode_and_owner_are_as_documented(rights: dict[str, str], place: InstalledPath) -> None:
    assert rights[str(place.path)] == f"{place.mode:o} {place.owner} {place.group}"


def test_other_users_cannot_write_any_installed_file(machine: Machine) -> None:
    assert machine.run("find", *OURS, "-not", "-type", "l", "-perm", "/002").stdout == ""


def test_the_services_user_owns_neither_program_nor_configuration(machine: Machine) -> None:
    assert machine.run("find", "/opt/fringed", "/etc/fringed", "-user", "fringed").stdout == ""
    writable = "find /opt/fringed /etc/fringed -writable -not -type l"
    assert (
        machine.run("setpriv", "--reuid=fringed", "--regid=fringed", "--init-groups", "sh", "-c", writable).stdout == ""
    )


def test_login_as_its_users_is_impossible(machine: Machine) -> None:
    users = [line.split(":") for line in machine.run("cat", "/etc/passwd").stdout.splitlines() if "fringed" in line]
    assert {user[0] for user in users} == {"fringed", "fringed-view"}
    assert {user[6].rsplit("/", 1)[-1] for user in users} == {"nologin"}


@pytest.mark.parametrize("unit", UNITS)
def test_the_exposure_score_is_below_the_limit(machine: Machine, unit: str) -> None:
    output = machine.run("systemd-analyze", "security", "--no-pager", unit).stdout
    level = re.search(r"Overall exposure level for \S+: ([\d.]+)", output)
    assert level is not None and float(level[1]) <= 2.5, output


def test_systemd_analyze_verify_reports_nothing_about_the_units(machine: Machine) -> None:
    done = machine.run("systemd-analyze", "verify", *UNITS, check=False)
    output = [line for line in (done.stdout + done.stderr).splitlines() if "fringed" in line]
    assert (done.returncode, output) == (0, [])


def test_a_second_installation_changes_nothing(machine: Machine) -> None:
    def state() -> str:
        return machine.run("find", *OURS[:3], "-printf", "%p %m %u %g %s %l\n").stdout

    machine.fringed(*_INSTALL, "--rig", "/root/rig.yaml")
    before = state()
    machine.fringed(*_INSTALL, "--rig", "/root/rig.yaml")
    assert state() == before


def test_a_rig_file_of_the_user_is_kept(machine: Machine) -> None:
    own = rig(device={"name": "my-own"})
    (machine.root / "etc/fringed/rig.yaml").write_text(own)
    assert "rig.yaml.new" in machine.fringed(*_INSTALL, "--rig", "/root/rig.yaml").stdout
    assert (machine.root / "etc/fringed/rig.yaml").read_text() == own
    assert (machine.root / "etc/fringed/rig.yaml.new").read_text() == rig()


@pytest.mark.parametrize(
    "prefix",
    ["/usr", "opt/fringed", "/opt/../etc", *(pytest.param(each, marks=pytest.mark.long) for each in ("/", "/root"))],
)
def test_a_foreign_prefix_is_refused(machine: Machine, prefix: str) -> None:
    done = machine.fringed(*_INSTALL, "--prefix", prefix, check=False)
    assert done.returncode != 0 and "--prefix" in done.stderr


def test_a_rig_with_mistakes_is_not_installed(machine: Machine) -> None:
    (machine.root / "root/bad.yaml").write_text(rig() + "nonsense: 1\n")
    done = machine.fringed(*_INSTALL, "--rig", "/root/bad.yaml", check=False)
    assert done.returncode != 0 and "nonsense" in done.stderr


@pytest.mark.last
def test_uninstall_leaves_the_data_and_purge_nothing(machine: Machine) -> None:
    (machine.root / "var/lib/fringed/takes/kept.mcap").write_bytes(b"take")
    assert "Removed" not in machine.fringed("uninstall").stderr
    left = machine.run("find", *OURS, check=False).stdout.split()
    assert {"/etc/fringed/rig.yaml", "/var/lib/fringed/takes/kept.mcap"} <= set(left)
    assert [path for path in left if path.startswith((str(PREFIX), "/var/cache"))] == []
    assert machine.run("sh", "-c", "ls /etc/systemd/system/*fringed* /usr/local/bin/fringed", check=False).stdout == ""
    assert machine.fringed("uninstall", check=False).returncode != 0

    machine.fringed(*_INSTALL)
    assert (machine.root / "etc/fringed/rig.yaml").read_text() == rig(device={"name": "my-own"})
    machine.fringed("uninstall", "--purge")
    assert machine.run("find", *OURS, check=False).stdout == ""
    assert "fringed" not in machine.run("cat", "/etc/passwd", "/etc/group").stdout
    assert machine.systemctl("is-system-running", check=False) == "running"
