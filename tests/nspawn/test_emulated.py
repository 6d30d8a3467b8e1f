"""The service with the real drivers: emulated GenICam cameras, and the projector's window on the service's X server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.nspawn import emulation
from tests.nspawn.helpers import MARKS, POLL_S, SERVICE, Fringed
from tools.nspawn.machine import WAIT_S
from tools.waiting import wait_until

pytestmark = MARKS


@pytest.fixture(scope="module")
def rig_yaml(installed: Fringed) -> Iterator[str]:
    """The devices of the rig, without the daemon."""
    installed.stop()
    emulation.start_x(installed)
    yield emulation.start_box(installed)
    installed.machine.systemctl("stop", emulation.BOX, emulation.X)


@pytest.fixture(scope="module")
def started(installed: Fringed, rig_yaml: str) -> Iterator[Fringed]:
    installed.start(rig_yaml, emulation.DROP_IN)
    yield installed
    installed.stop()


@pytest.fixture
def running(started: Fringed, rig_yaml: str) -> Fringed:
    """The service, measuring, whatever the previous test did to it."""
    if started.show()["ActiveState"] != "active":
        started.start(rig_yaml, emulation.DROP_IN)
    started.wait_clouds(1)
    return started


def test_it_measures_with_the_real_drivers(running: Fringed) -> None:
    status = running.wait_status("state running", lambda status: status["state"] == "running")
    assert status["points"] > 100
    assert {camera["state"] for camera in status["cameras"].values()} == {"acquiring"}


def test_its_processes_are_in_its_own_group_and_run_as_its_user(running: Fringed) -> None:
    group = running.machine.show(SERVICE, "ControlGroup")["ControlGroup"]
    listed = running.machine.run("cat", f"/sys/fs/cgroup/systemd{group}/cgroup.procs", check=False).stdout.split()
    listed = listed or running.machine.run("cat", f"/sys/fs/cgroup{group}/cgroup.procs").stdout.split()
    assert len(listed) >= 4  # the daemon, two cameras, the window
    assert set(running.machine.run("ps", "-o", "user=", "-p", ",".join(listed)).stdout.split()) == {"fringed"}


def test_other_users_have_no_access_to_the_projectors_x_server(running: Fringed) -> None:
    asked = "xrandr", "--display", ":9", "--query"
    assert running.machine.run(*asked, user="nobody", check=False).returncode != 0
    inside = running.machine.run(*asked, user="fringed", env={"XAUTHORITY": "/run/fringed-x/authority"})
    assert "DUMMY1 connected" in inside.stdout
    server = Path(f"/proc/{running.pid_outside(running.machine.show(emulation.X, 'MainPID')['MainPID'])}/status")
    assert [line.split()[1].strip("0") for line in server.read_text().splitlines() if "CapEff" in line] == [""]
    listening = [line for line in running.machine.run("cat", "/proc/net/tcp").stdout.splitlines() if " 0A " in line]
    assert not [line for line in listening if ":1779" in line]  # 6009, of display 9


def test_an_unplugged_camera_is_retried_until_it_returns(running: Fringed) -> None:
    before = running.show()
    emulation.plug(running, 1, "out")
    running.wait_status("the loss", lambda status: any("camera right" in reason for reason in status["reasons"]))
    running.wait("the status line", lambda shown: "camera right" in shown["StatusText"])
    emulation.plug(running, 1, "in")
    running.wait_status("the camera's return", lambda status: status["state"] == "running")
    running.wait_clouds()
    after = running.show()
    assert (after["MainPID"], after["NRestarts"]) == (before["MainPID"], before["NRestarts"])


def test_a_killed_x_server_is_restarted_with_the_pattern(running: Fringed) -> None:
    before, server = running.show(), running.machine.show(emulation.X, "MainPID")["MainPID"]
    running.machine.systemctl("kill", "--signal=KILL", "--kill-who=main", emulation.X)
    running.machine.wait_show(
        emulation.X, "another X server",
        lambda shown: shown["ActiveState"] == "active" and shown["MainPID"] not in ("0", server),
        "ActiveState", "MainPID",
    )  # fmt: skip
    status = running.wait_status("the projector's return", lambda status: status["state"] == "running")
    running.wait_status("good clouds", lambda now: now["clouds"] > status["clouds"] + 3 and now["points"] > 100)
    after = running.show()
    assert (after["MainPID"], after["NRestarts"]) == (before["MainPID"], before["NRestarts"])


def test_without_triggers_the_watchdog_does_not_fire(running: Fringed) -> None:
    before = running.show()
    watched_s = int(running.machine.show(SERVICE, "WatchdogUSec")["WatchdogUSec"].removesuffix("s"))
    running.machine.systemctl("kill", "--signal=STOP", "--kill-who=main", emulation.BOX)
    try:
        began = running.status()["uptime_s"]
        running.wait_status("a time without triggers", lambda status: status["uptime_s"] > began + watched_s + 3)
        assert running.show()["MainPID"] == before["MainPID"]
    finally:
        running.machine.systemctl("kill", "--signal=CONT", "--kill-who=main", emulation.BOX)
    running.wait_clouds()
    assert running.show()["NRestarts"] == before["NRestarts"]


def test_after_sigkill_it_restarts_with_cameras_and_projector(running: Fringed) -> None:
    before = running.show()
    running.machine.systemctl("kill", "--signal=KILL", "--kill-who=main", SERVICE)
    running.wait_active(not_pid=before["MainPID"])
    running.wait_clouds()


def test_a_stop_leaves_no_process(running: Fringed) -> None:
    running.machine.systemctl("stop", SERVICE)
    assert running.show()["Result"] == "success"

    def gone() -> bool:
        listed = running.machine.run("ps", "-u", "fringed", "-o", "unit=,args=", check=False).stdout.splitlines()
        return not [line for line in listed if SERVICE in line.split()[:1]]

    wait_until(gone, WAIT_S, "the end of all processes of the service", poll_s=POLL_S)
