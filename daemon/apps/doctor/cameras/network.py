"""GigE Vision cameras: packet size and speed of the network interfaces, and the kernel's receive buffer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("network")

RMEM = "/proc/sys/net/core/rmem_max"
_RMEM_RECOMMENDED, _RMEM_LEAST = 33554432, 8 << 20
_JUMBO, _GIGABIT = 8000, 1000
_ETHERNET = 1


def check(subject: Subject) -> Iterator[Finding]:
    """Check the active interfaces and the receive buffer."""
    used = data_rate.transport_used(subject, "GEV")
    if used is False:
        yield area.note("cameras", "no GigE Vision camera is connected")
        return
    certain = used is True or subject.uses("genicam")
    wired = interfaces(subject)
    for directory in wired:
        yield interface(subject, directory, certain=certain)
    if not wired:
        yield area.note("interfaces", "no wired network interface is up")
    if wired or certain:
        yield receive_buffer(subject, certain=certain)


def interfaces(subject: Subject) -> list[Path]:
    """Directories of the active wired hardware interfaces below /sys/class/net."""
    machine = subject.machine
    return [
        path
        for path in machine.entries("/sys/class/net/*")
        if (path / "device").exists()
        and not (path / "wireless").exists()
        and machine.number(path / "type") == _ETHERNET
        and machine.text(path / "operstate") == "up"
    ]


def interface(subject: Subject, directory: Path, *, certain: bool) -> Finding:
    """Check one interface."""
    mtu, speed = subject.machine.number(directory / "mtu") or 0, subject.machine.number(directory / "speed") or 0
    name = directory.name
    if 0 < speed < _GIGABIT:
        text = f"{name} runs at {speed} Mbit/s, GigE Vision needs {_GIGABIT}"
        return _graded(name, text, "use a Gigabit socket and a cable of category 5e or better", certain)
    if mtu < _JUMBO:
        text = f"{name} has an MTU of {mtu}: images take six times as many packets as with jumbo frames"
        remedy = f"sudo ip link set {name} mtu 9000 (if the cameras are on {name}; switches must allow it)"
        return _graded(name, text, remedy, certain)
    return area.ok(name, f"{name}: MTU {mtu}{f', {speed} Mbit/s' if speed > 0 else ''}")


def receive_buffer(subject: Subject, *, certain: bool) -> Finding:
    """Check the largest receive buffer of a socket."""
    size = subject.machine.number(RMEM)
    if size is None:
        return area.note("rmem_max", "the kernel does not report net.core.rmem_max")
    if size >= _RMEM_LEAST:
        return area.ok("rmem_max", f"net.core.rmem_max is {size} bytes")
    text = f"net.core.rmem_max is {size} bytes: packets of GigE Vision would be lost under load"
    remedy = f"sudo sysctl -w net.core.rmem_max={_RMEM_RECOMMENDED}; permanently: in /etc/sysctl.d/60-cameras.conf"
    return _graded("rmem_max", text, remedy, certain)


def _graded(name: str, text: str, remedy: str, certain: bool) -> Finding:
    return area.warning(name, text, remedy) if certain else area.note(name, text, remedy)
