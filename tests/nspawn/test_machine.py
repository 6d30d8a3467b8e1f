"""The container itself: it boots, is isolated, and ends with the process that started it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.nspawn import Machine, MachineError
from tools.waiting import wait_until

pytestmark = [pytest.mark.nspawn, pytest.mark.xdist_group("nspawn"), pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def bare(container: type[Machine]) -> Iterator[Machine]:
    with container() as machine:
        yield machine


def test_it_boots_without_a_failed_unit(bare: Machine) -> None:
    assert bare.systemctl("is-system-running", check=False) == "running"
    assert bare.show("multi-user.target", "ActiveState") == {"ActiveState": "active"}


def test_the_project_is_mounted_from_any_path(bare: Machine) -> None:
    assert "usage" in bare.fringed("--help").stdout.lower()


def test_writes_inside_do_not_change_the_machine(bare: Machine) -> None:
    here = Path(__file__).resolve().relative_to(Path(__file__).resolve().parents[2])
    bare.run("sh", "-c", f"echo changed > /checkout/{here}; echo changed > /etc/hostname; touch /usr/mark /tmp/mark")
    assert bare.run("cat", "/etc/hostname").stdout == "changed\n"
    assert "changed\n" not in Path("/etc/hostname").read_text()
    assert not Path("/usr/mark").exists() and not Path("/tmp/mark").exists()
    assert Path(__file__).read_text() != "changed\n"


def test_its_network_is_a_loopback_of_its_own_only(bare: Machine) -> None:
    names = [line.split(":")[0].strip() for line in bare.run("cat", "/proc/net/dev").stdout.splitlines()[2:]]
    assert names == ["lo"]


def test_services_have_cgroups_of_their_own(bare: Machine) -> None:
    done = bare.run("systemd-run", "--quiet", "--wait", "--pipe", "--unit=seen", "cat", "/proc/self/cgroup")
    assert "/system.slice/seen.service" in done.stdout


def test_the_error_of_a_failing_command_has_its_output(bare: Machine) -> None:
    with pytest.raises(MachineError, match=r"(?s)ended with 3:.*no such thing"):
        bare.run("sh", "-c", "echo no such thing >&2; exit 3")


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.usefixtures("container")
def test_it_ends_with_the_process_that_started_it(end: signal.Signals) -> None:
    command = [sys.executable, "-m", "tools.nspawn"]
    starter = subprocess.Popen(command, cwd=Path(__file__).parents[2], stdout=subprocess.PIPE, text=True)
    try:
        assert starter.stdout is not None
        leader = int(starter.stdout.readline().partition("--target=")[2].split()[0])
        assert Path(f"/proc/{leader}/comm").read_text().strip() == "systemd"
    finally:
        starter.send_signal(end)
        starter.communicate(timeout=150)
    wait_until(lambda: not Path(f"/proc/{leader}").exists(), 60, "the end of the container's systemd")
    assert "fringed-nspawn" not in Path("/proc/mounts").read_text()
