"""The machine's clock: clouds carry its time, so it should be that of the other machines."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.doctor.ask import ask, there
from daemon.doctor.finding import Area, Finding
from daemon.doctor.subject import Subject

area = Area("clock")

_LATE_S = 0.01
_REMEDY = "sudo apt install chrony (or: sudo timedatectl set-ntp true), and let the network reach a time server"


def check(subject: Subject) -> Iterator[Finding]:  # noqa: ARG001 - every check has it
    """Ask chrony, else systemd; say nothing against a machine with neither."""
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
    yield area.note("clock", "neither chrony nor systemd tells whether the clock is synchronised")


def chrony(text: str) -> Finding:
    """From the line of comma-separated values of ``chronyc -c tracking``."""
    fields = text.strip().split(",")
    try:
        offset_s, leap = abs(float(fields[4])), fields[-1]
    except (IndexError, ValueError):
        return area.note("clock", f"chrony's answer is not understood: {text[:80]}")
    if leap == "Not synchronised":
        return area.warning("clock", "chrony is not synchronised with any server", _REMEDY)
    if offset_s > _LATE_S:
        remedy = "wait a few minutes, or: sudo chronyc makestep (not while measuring)"
        return area.warning("clock", f"the clock is {1e3 * offset_s:.1f} ms off", remedy)
    return area.ok("clock", f"synchronised by chrony, {1e6 * offset_s:.0f} us off")


def systemd(text: str) -> Finding:
    """From systemd's yes or no."""
    if text == "yes":
        return area.ok("clock", "synchronised (systemd)")
    return area.warning("clock", "the clock is not synchronised with any server", _REMEDY)
