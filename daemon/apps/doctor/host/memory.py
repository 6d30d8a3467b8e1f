"""Memory for the daemon, and swapping."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("memory")

BASE_MB = 450.0
"""Interpreter, libraries and compiled kernels; a simulated rig of 1024 x 820 pixels used 540 MB in total."""
ARRAYS_PER_PIXEL = 120.0
"""Approximate bytes of the pipeline's arrays per camera pixel."""
DEVICES_MB = 250.0
"""The processes of two GenICam cameras and of the projector's window."""


def check(subject: Subject) -> Iterator[Finding]:
    """Compare the available with the required memory, and check the swap space."""
    values = meminfo(subject.machine.text("/proc/meminfo"))
    if "MemAvailable" not in values:
        yield area.note("memory", "/proc/meminfo contains no MemAvailable")
        return
    available, total = values["MemAvailable"] / 1e3, values.get("MemTotal", 0) / 1e3
    need = need_mb(subject)
    text = f"{available / 1e3:.1f} of {total / 1e3:.1f} GB are available, about {need / 1e3:.1f} are needed"
    if available < need:
        yield area.problem("memory", text, "end other programs, or use a PC with more memory")
    elif available < 1.5 * need:
        yield area.warning("memory", text, "end other programs before measuring")
    else:
        yield area.ok("memory", text)
    swapped = values.get("SwapTotal", 0) - values.get("SwapFree", 0)
    if swapped > 0.5 * values.get("SwapTotal", 0) and swapped > 512_000:
        text = f"{swapped / 1e6:.1f} GB are swapped out and slow to access"
        yield area.warning("swap", text, "end programs that use much memory, then: sudo swapoff -a && sudo swapon -a")


def need_mb(subject: Subject) -> float:
    """Estimate of the required memory: the program, the pipeline's arrays, the queued frames."""
    config = subject.config
    size = data_rate.image_size(subject, "left") or (1024, 820)
    queued = 8 + (config.recording.queue + config.pipeline.queue if config is not None else 61)
    frames = (sum(data_rate.frame_bytes(subject)) or 2 * size[0] * size[1]) * queued
    base = BASE_MB + (DEVICES_MB if subject.uses("genicam") or subject.uses("x11") else 0.0)
    before = config.recording.before_mb if config is not None and config.recording.before_s > 0 else 0
    return base + before + (size[0] * size[1] * ARRAYS_PER_PIXEL + frames) / 1e6


def meminfo(text: str) -> dict[str, int]:
    """Parse /proc/meminfo; values in kB."""
    values = {}
    for line in text.splitlines():
        name, _, value = line.partition(":")
        number = value.split()[:1]
        if number and number[0].isdigit():
            values[name.strip()] = int(number[0])
    return values
