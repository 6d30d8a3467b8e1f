"""The machine's clock: clouds are stamped with its time, so it must agree with other machines."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import is_installed, run_program
from daemon.monitoring.health.observe import clock_sync
from daemon.monitoring.health.observe.clock_sync import ClockSync

area = Area("clock")

_LATE_MS = 10.0
_REMEDY = "sudo apt install chrony (or: sudo timedatectl set-ntp true), and let the network reach a time server"


def check(subject: Subject) -> Iterator[Finding]:  # noqa: ARG001 - every check has it
    """Query chrony, else systemd, else the kernel; without an answer the finding is a note."""
    if is_installed("chronyc"):
        answer = run_program(["chronyc", "-c", "tracking"], 5.0)
        if answer.status == 0:
            yield chrony(answer.out)
            return
    if is_installed("timedatectl"):
        answer = run_program(["timedatectl", "show", "--property=NTPSynchronized", "--value"], 5.0)
        if answer.status == 0 and answer.out in ("yes", "no"):
            yield systemd(answer.out)
            return
    sync = clock_sync.kernel()
    unknown = area.note("clock", "neither chrony nor systemd reports whether the clock is synchronised")
    yield unknown if sync is None else sync_finding(sync)


def chrony(text: str) -> Finding:
    """The finding for the comma-separated line of ``chronyc -c tracking``."""
    sync = clock_sync.chrony(text)
    return area.note("clock", f"chrony's answer cannot be parsed: {text[:80]}") if sync is None else sync_finding(sync)


def sync_finding(sync: ClockSync) -> Finding:
    """The finding for the state that chrony or the kernel reports."""
    if not sync.synchronised:
        return area.warning("clock", f"the clock is not synchronised with any server ({sync.source})", _REMEDY)
    offset_ms = abs(sync.offset_ms or 0.0)
    if offset_ms > _LATE_MS:
        remedy = "wait a few minutes, or: sudo chronyc makestep (not while measuring)"
        return area.warning("clock", f"the clock is {offset_ms:.1f} ms off", remedy)
    return area.ok("clock", f"synchronised ({sync.source}), {1e3 * offset_ms:.0f} us off")


def systemd(text: str) -> Finding:
    """The finding for systemd's answer, yes or no."""
    if text == "yes":
        return area.ok("clock", "synchronised (systemd)")
    return area.warning("clock", "the clock is not synchronised with any server", _REMEDY)
