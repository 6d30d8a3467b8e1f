"""The machine's clock: clouds carry its time, so it should be that of the other machines."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import ask, there
from daemon.monitoring.health.observe import clock_sync
from daemon.monitoring.health.observe.clock_sync import ClockSync

area = Area("clock")

_LATE_MS = 10.0
_REMEDY = "sudo apt install chrony (or: sudo timedatectl set-ntp true), and let the network reach a time server"


def check(subject: Subject) -> Iterator[Finding]:  # noqa: ARG001 - every check has it
    """Ask chrony, else systemd, else the kernel; say nothing against a machine where nobody tells."""
    if there("chronyc"):
        answer = ask(["chronyc", "-c", "tracking"], 5.0)
        if answer.status == 0:
            yield chrony(answer.out)
            return
    if there("timedatectl"):
        answer = ask(["timedatectl", "show", "--property=NTPSynchronized", "--value"], 5.0)
        if answer.status == 0 and answer.out in ("yes", "no"):
            yield systemd(answer.out)
            return
    told = clock_sync.kernel()
    yield (
        area.note("clock", "neither chrony nor systemd tells whether the clock is synchronised")
        if told is None
        else (judged(told))
    )


def chrony(text: str) -> Finding:
    """From the line of comma-separated values of ``chronyc -c tracking``."""
    told = clock_sync.chrony(text)
    return area.note("clock", f"chrony's answer is not understood: {text[:80]}") if told is None else judged(told)


def judged(told: ClockSync) -> Finding:
    """From what chrony or the kernel tells."""
    if not told.synchronised:
        return area.warning("clock", f"the clock is not synchronised with any server ({told.source})", _REMEDY)
    offset_ms = abs(told.offset_ms or 0.0)
    if offset_ms > _LATE_MS:
        remedy = "wait a few minutes, or: sudo chronyc makestep (not while measuring)"
        return area.warning("clock", f"the clock is {offset_ms:.1f} ms off", remedy)
    return area.ok("clock", f"synchronised ({told.source}), {1e3 * offset_ms:.0f} us off")


def systemd(text: str) -> Finding:
    """From systemd's yes or no."""
    if text == "yes":
        return area.ok("clock", "synchronised (systemd)")
    return area.warning("clock", "the clock is not synchronised with any server", _REMEDY)
