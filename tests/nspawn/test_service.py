"""The service under a real systemd: readiness, status line, watchdog, reload, stop."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fringed import subscribe
from tests.nspawn.freeze import frozen, thread_of
from tests.nspawn.helpers import MARKS, POLL_S, RIG, SERVICE, Fringed, rig
from tools.nspawn.machine import WAIT_S
from tools.waiting import wait_until

pytestmark = MARKS


@pytest.fixture(scope="module")
def started(installed: Fringed) -> Iterator[Fringed]:
    """The service, in any state."""
    yield installed
    installed.stop()


@pytest.fixture
def running(started: Fringed) -> Fringed:
    """The service, measuring, whatever the previous test did to it."""
    if started.show()["ActiveState"] != "active":
        started.start(rig())
    started.wait_clouds(1)
    return started


def test_it_starts_with_the_machine(started: Fringed) -> None:
    assert started.machine.systemctl("is-enabled", SERVICE) == "enabled"


def test_without_a_trigger_it_waits_and_the_status_line_reports_it(started: Fringed) -> None:
    stepped = rig(simulation={"scene": "plane", "frames": 2, "rate_hz": 0.0, "layout": {"scale": 0.125}})
    started.start(stepped, wait=False)
    started.wait("the wait for the trigger", lambda shown: "waiting for the trigger" in shown["StatusText"])
    uptime = started.status()["uptime_s"]
    status = started.wait_status("two more seconds", lambda status: status["uptime_s"] > uptime + 2)
    shown = started.show()
    assert (shown["ActiveState"], shown["NRestarts"], status["clouds"]) == ("activating", "0", 0)


def test_it_is_ready_only_with_a_first_cloud(started: Fringed) -> None:
    started.start(rig(), wait=False)
    seen = {"activating": False}

    def ready() -> bool:
        state = started.show()["ActiveState"]
        seen[state] = True
        return state == "active"

    wait_until(ready, WAIT_S, "the service being ready", poll_s=POLL_S)
    assert started.status()["clouds"] >= 1
    assert seen["activating"]


def test_the_status_line_has_rate_points_and_drops(running: Fringed) -> None:
    shape = r"running: \d+\.\d clouds/s of \d+\.\d pairs/s, \d+ points, .*dropped \d+"
    running.wait("the status line", lambda shown: re.match(shape, shown["StatusText"]) is not None)


def test_the_journal_has_fields_to_search_for(running: Fringed) -> None:
    session = running.status()["session"]
    lines = running.machine.journal(SERVICE, f"FRINGED_SESSION={session}")
    assert lines
    assert {line["FRINGED_DEVICE"] for line in lines} == {"nspawn"}
    assert {line["_SYSTEMD_UNIT"] for line in lines} == {SERVICE}
    assert all({"PRIORITY", "LOGGER", "CODE_FILE", "THREAD_NAME"} <= line.keys() for line in lines)
    assert {line["FRINGED_SIDE"] for line in lines if "FRINGED_SIDE" in line} <= {"left", "right"}


def test_it_runs_as_a_user_with_no_rights(running: Fringed) -> None:
    status = Path(f"/proc/{running.pid_outside(running.show()['MainPID'])}/status").read_text()
    fields = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
    assert fields["CapEff"].strip("0") == fields["CapBnd"].strip("0") == ""
    assert fields["NoNewPrivs"] == "1" and fields["Seccomp"] == "2"
    assert set(fields["Uid"].split()) == {running.machine.run("id", "-u", "fringed").stdout.strip()} != {"0"}


def test_its_share_of_the_processors_is_ten_times_that_of_another_service(running: Fringed) -> None:
    assert running.machine.show(SERVICE, "CPUWeight") == {"CPUWeight": "1000"}


def test_sockets_are_accessible_to_its_group_only(running: Fringed) -> None:
    there = running.machine.run("stat", "-c", "%A %U %G %n", "/run/fringed", "/run/fringed/control").stdout.split("\n")
    assert there[0] == "drwxr-x--- fringed fringed /run/fringed"
    assert re.fullmatch(r"srw.{4}--- fringed fringed /run/fringed/control", there[1]), there


def test_it_listens_on_loopback_only(running: Fringed) -> None:
    listening = re.findall(r"^\s*\d+: (\S+):(\S+) \S+ 0A", running.machine.run("cat", "/proc/net/tcp").stdout, re.M)
    six = running.machine.run("cat", "/proc/net/tcp6").stdout
    assert ("0100007F", f"{5555:04X}") in listening
    assert {address for address, _ in listening} == {"0100007F"}
    assert " 0A " not in six


def test_clouds_come_through_the_socket(running: Fringed) -> None:
    with subscribe(f"ipc://{running.machine.root}/run/fringed/stream", timeout_s=60) as clouds:
        assert np.isfinite(next(iter(clouds)).xyz).all(axis=2).sum() > 100


def test_the_command_finds_the_service(running: Fringed) -> None:
    assert "running" in running.machine.run("fringed", "status").stdout


def test_after_sigkill_it_restarts(running: Fringed) -> None:
    before = running.show()
    running.machine.systemctl("kill", "--signal=KILL", "--kill-who=main", SERVICE)
    after = running.wait_active(not_pid=before["MainPID"])
    assert int(after["NRestarts"]) == int(before["NRestarts"]) + 1
    assert running.wait_clouds()["pid"] == int(after["MainPID"])


def test_a_frozen_process_is_killed_and_restarted(running: Fringed) -> None:
    since, before = running.cursor(), running.show()
    os.kill(running.pid_outside(before["MainPID"]), signal.SIGSTOP)
    running.wait_active(not_pid=before["MainPID"])
    running.wait_logged("Watchdog timeout", since, "the reason")
    running.wait_clouds()


@pytest.mark.parametrize("thread", ["pipeline", pytest.param("camera-left", marks=pytest.mark.long)])
def test_one_frozen_thread_triggers_the_watchdog(running: Fringed, thread: str) -> None:
    since, before = running.cursor(), running.show()
    with frozen(thread_of(running.pid_outside(before["MainPID"]), thread)):
        running.wait_active(not_pid=before["MainPID"])
    running.wait_logged("Watchdog timeout", since, "the reason")
    running.wait_logged("watchdog is not fed", since, "the line of the journal")
    messages = [line for line in running.lines(since) if "watchdog is not fed" in str(line.get("MESSAGE"))]
    assert thread.split("-")[-1] in messages[0]["MESSAGE"]
    running.wait_clouds()


def test_a_valid_change_takes_effect_while_it_measures(running: Fringed) -> None:
    before, since = running.show(), running.cursor()
    points = running.wait_clouds()["points"]
    running.write(RIG, rig(pipeline={"settings": {"min_modulation": 100.0}}))
    running.machine.systemctl("reload", SERVICE)
    running.wait_status("clouds under the new setting", lambda status: status["points"] < points // 10)
    running.wait_logged("reloaded", since, "the line that reports it")
    running.write(RIG, rig())
    running.machine.systemctl("reload", SERVICE)
    running.wait_status("clouds as before", lambda status: status["points"] > points // 2)
    after = running.show()
    assert (after["MainPID"], after["ActiveState"]) == (before["MainPID"], "active")


@pytest.mark.parametrize(
    ("bad", "reported"),
    [("pipeline: {settings: {min_modulation: high}}\n", "min_modulation"), ("{ no yaml\n", f"{RIG}:")],
)
def test_an_invalid_file_changes_nothing(running: Fringed, bad: str, reported: str) -> None:
    before, since = running.show(), running.cursor()
    running.write(RIG, rig() + bad)
    done = running.machine.run("systemctl", "reload", SERVICE, check=False)
    assert done.returncode != 0
    running.wait_logged(reported, since, "the mistake in the journal")
    running.wait_clouds()
    assert running.show()["MainPID"] == before["MainPID"]
    running.write(RIG, rig())


def test_a_setting_that_needs_a_restart_is_reported_and_nothing_changes(running: Fringed) -> None:
    before, since = running.show(), running.cursor()
    points = running.wait_clouds()["points"]
    running.write(RIG, rig(device={"name": "another"}, pipeline={"settings": {"min_modulation": 100.0}}))
    running.machine.systemctl("reload", SERVICE, check=False)
    wait_until(
        lambda: any("device" in str(line.get("MESSAGE")) and "restart" in str(line.get("MESSAGE"))
                    for line in running.lines(since)),
        WAIT_S, "what needs a restart", poll_s=POLL_S,
    )  # fmt: skip
    status = running.wait_clouds()
    assert status["device"] == "nspawn" and status["points"] > points // 2
    assert running.show()["MainPID"] == before["MainPID"]
    running.write(RIG, rig())


def test_an_invalid_rig_is_not_retried(started: Fringed) -> None:
    since = started.cursor()
    started.start(rig() + "nonsense: 1\n", wait=False)
    shown = started.wait("the failed state", lambda shown: shown["ActiveState"] == "failed")
    assert shown["NRestarts"] == "0"
    started.wait_logged("nonsense", since, "the reason")
    started.stop()


def test_a_daemon_that_ends_at_once_is_started_ten_times_within_ten_seconds(started: Fringed) -> None:
    since = started.cursor()
    started.start(rig(), "ExecStart=\nExecStart=/bin/false", wait=False)
    shown = started.wait("the end of the restarts", lambda shown: shown["ActiveState"] == "failed")
    assert shown["NRestarts"] == "10"
    started.wait_logged("Start request repeated too quickly", since, "the reason")
    started.start(rig())  # after reset-failed


def test_a_stop_is_orderly(running: Fringed) -> None:
    with running.control() as client:
        file = client.call("record.start", name="stopped")["file"]
    running.wait_clouds()
    since = running.cursor()
    running.machine.systemctl("stop", SERVICE)
    shown = running.show()
    assert (shown["ActiveState"], shown["Result"]) == ("inactive", "success")
    running.wait_logged("stopped:", since, "the last line")
    assert not (running.machine.root / "run/fringed").exists()
    take = running.machine.run("fringed", "info", file).stdout
    assert "pairs" in take
    rights = running.machine.run("stat", "-c", "%A %U", file).stdout.split()
    assert rights[0][7:] == "---" and rights[1] == "fringed"
