"""GigE Vision cameras: packet size and speed of the network interfaces, and the kernel's receive buffer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("network")

RMEM = "/proc/sys/net/core/rmem_max"
_RMEM_WANTED, _RMEM_LEAST = 33554432, 8 << 20
_JUMBO, _GIGABIT = 8000, 1000
_ETHERNET = 1


def check(subject: Subject) -> Iterator[Finding]:
    """Interfaces that are up, and the receive buffer."""
    used = data_rate.wanted(subject, "GEV")
    if used is False:
        yield area.note("cameras", "no GigE Vision camera is seen")
        return
    certain = used is True or subject.uses("genicam")
    wired = interfaces(subject)
    for place in wired:
        yield interface(subject, place, certain=certain)
    if not wired:
        yield area.note("interfaces", "no wired network interface is up")
    if wired or certain:
        yield receive_buffer(subject, certain=certain)


def interfaces(subject: Subject) -> list[Path]:
    """Wired interfaces of real hardware that are up, below /sys/class/net."""
    machine = subject.machine
    return [
        place
        for place in machine.entries("/sys/class/net/*")
        if (place / "device").exists()
        and not (place / "wireless").exists()
        and machine.number(place / "type") == _ETHERNET
        and machine.text(place / "operstate") == "up"
    ]


def interface(subject: Subject, place: Path, *, certain: bool) -> Finding:
    """One interface."""
    mtu, speed = subject.machine.number(place / "mtu") or 0, subject.machine.number(place / "speed") or 0
    name = place.name
    if 0 < speed < _GIGABIT:
        text = f"{name} runs at {speed} Mbit/s, GigE Vision needs {_GIGABIT}"
        return _judged(name, text, "use a Gigabit socket and a cable of category 5e or better", certain)
    if mtu < _JUMBO:
        text = f"{name} has an MTU of {mtu}: GigE Vision needs six times the packets of jumbo frames"
        remedy = f"sudo ip link set {name} mtu 9000 (if the cameras are on {name}; switches must allow it)"
        return _judged(name, text, remedy, certain)
    return area.ok(name, f"{name}: MTU {mtu}{f', {speed} Mbit/s' if speed > 0 else ''}")


def receive_buffer(subject: Subject, *, certain: bool) -> Finding:
    """The largest buffer that a socket may ask for."""
    size = subject.machine.number(RMEM)
    if size is None:
        return area.note("rmem_max", "the kernel does not tell net.core.rmem_max")
    if size >= _RMEM_LEAST:
        return area.ok("rmem_max", f"net.core.rmem_max is {size} bytes")
    text = f"net.core.rmem_max is {size} bytes: packets of GigE Vision would be lost under load"
    remedy = f"sudo sysctl -w net.core.rmem_max={_RMEM_WANTED}; for good: that line in /etc/sysctl.d/60-cameras.conf"
    return _judged("rmem_max", text, remedy, certain)


def _judged(name: str, text: str, remedy: str, certain: bool) -> Finding:
    return area.warning(name, text, remedy) if certain else area.note(name, text, remedy)
