"""Messages to the service manager."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.bootstrap.systemd.notifier import Notifier
from tests.daemon.bootstrap.systemd.manager import Manager


def test_every_message_has_the_format_of_systemd(manager: Manager) -> None:
    notifier = Notifier(manager.address, watchdog_s=10.0)
    assert notifier.ready("30 clouds/s") and notifier.alive() and notifier.extend(2.5)
    assert notifier.reloading() and notifier.stopping()
    ready, alive, extend, reloading, stopping = manager.read()
    assert ready == {"READY": "1", "STATUS": "30 clouds/s"}
    assert alive == {"WATCHDOG": "1"} and extend == {"EXTEND_TIMEOUT_USEC": "2500000"}
    assert reloading["RELOADING"] == "1" and int(reloading["MONOTONIC_USEC"]) > 0
    assert stopping["STOPPING"] == "1"
    notifier.close()


def test_an_abstract_address_works_too() -> None:
    manager = Manager.abstract()
    notifier = Notifier(manager.address)
    assert notifier.status("hello")
    assert manager.read() == [{"STATUS": "hello"}]
    notifier.close()
    manager.close()


def test_the_variables_are_taken_out_of_the_environment(manager: Manager) -> None:
    environ = manager.environment(watchdog_us=10_000_000) | {"WATCHDOG_PID": str(os.getpid()), "OTHER": "x"}
    notifier = Notifier.from_environment(environ)
    assert environ == {"OTHER": "x"} and notifier.active and notifier.watchdog_s == 10.0
    notifier.close()


@pytest.mark.parametrize(
    "environ",
    [
        {"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "10", "WATCHDOG_PID": "1"},
        {"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "0"},
        {"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "-5"},
        {"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "soon"},
        {"WATCHDOG_USEC": "10"},
        {},
    ],
)
def test_a_watchdog_for_another_process_or_of_invalid_time_is_ignored(environ: dict[str, str]) -> None:
    notifier = Notifier.from_environment(environ)
    assert notifier.watchdog_s is None
    notifier.close()


@pytest.mark.parametrize("address", ["", "relative/path", "vsock:2:1234"])
def test_without_a_manager_nothing_is_sent(address: str) -> None:
    notifier = Notifier.from_environment({"NOTIFY_SOCKET": address})
    assert not notifier.active and not notifier.ready("x") and notifier.failed == 0


def test_a_manager_that_has_ended_or_does_not_read_blocks_no_caller(tmp_path: Path, manager: Manager) -> None:
    nobody = Notifier(str(tmp_path / "nobody"))
    assert not nobody.alive() and nobody.failed == 1
    full = Notifier(manager.address)
    while full.alive():  # until its queue is full
        pass
    assert full.failed == 1
    nobody.close()
    full.close()


@settings(deadline=None, max_examples=50)
@given(st.text())
def test_a_status_cannot_contain_another_message(text: str) -> None:
    manager = Manager.abstract()
    notifier = Notifier(manager.address)
    assert notifier.status(text)
    (message,) = manager.read()
    assert set(message) == {"STATUS"} and len(message["STATUS"]) <= 400
    notifier.close()
    manager.close()
