"""Clock synchronisation from chrony, the kernel and systemd; without a source it is unknown."""

from __future__ import annotations

import pytest

from daemon.monitoring.health.observe import clock_sync
from daemon.monitoring.health.observe.clock_sync import ClockSync

TRACKING = "A29FC87B,time.example,3,1700000000.1,{0},-0.00001,0.00002,1,0,0,0.01,0.002,64.2,{1}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (TRACKING.format("-0.0125", "Normal"), ClockSync("chrony", True, -12.5)),
        (TRACKING.format("0.0", "Not synchronised"), ClockSync("chrony", False, None)),
        ("506 Cannot talk to daemon", None),
        ("", None),
        ("a,b,c,d,e,f,g,h,i,j,k,l,m,n", None),
    ],
)
def test_chrony(text: str, expected: ClockSync | None) -> None:
    assert clock_sync.chrony(text) == expected


@pytest.mark.parametrize(
    ("state", "status", "offset", "expected"),
    [
        (0, 0x2001, 1_500_000, ClockSync("kernel", True, 1.5)),
        (0, 0x0001, -1500, ClockSync("kernel", True, -1.5)),
        (5, 0x0041, 0, ClockSync("kernel", False, None)),
        (0, 0x0040, 0, ClockSync("kernel", False, None)),
    ],
)
def test_the_kernel(state: int, status: int, offset: int, expected: ClockSync) -> None:
    assert clock_sync.from_timex(state, status, offset) == expected


def test_this_machine_has_a_source_or_is_unknown() -> None:
    sync = clock_sync.clock_sync()
    assert sync.source in ("", "chrony", "kernel", "systemd")
    assert (sync.synchronised is None) == (sync.source == "")


def test_without_a_source_it_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_sync, "is_installed", lambda _: False)
    monkeypatch.setattr(clock_sync, "kernel", lambda: None)
    monkeypatch.setattr(clock_sync, "_TIMESYNCD", clock_sync.Path("/nowhere/at/all"))
    assert clock_sync.clock_sync() == ClockSync()


def test_without_an_answer_of_chrony_the_kernel_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise OSError("no")

    monkeypatch.setattr(clock_sync, "is_installed", lambda _: True)
    monkeypatch.setattr(clock_sync, "run_program", fails)
    monkeypatch.setattr(clock_sync, "kernel", lambda: ClockSync("kernel", True, 0.0))
    assert clock_sync.clock_sync().source == "kernel"
