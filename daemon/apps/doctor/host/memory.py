"""Memory: enough for the daemon, and no swapping while it measures."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("memory")

BASE_MB = 450.0
"""Interpreter, libraries and compiled kernels; a simulated rig of 1024 x 820 pixels took 540 MB in all."""
ARRAYS_PER_PIXEL = 120.0
"""Bytes of the pipeline's arrays for each pixel of a camera, roughly."""
DEVICES_MB = 250.0
"""The processes of two GenICam cameras and of the projector's window."""


def check(subject: Subject) -> Iterator[Finding]:
    """What is available against what is needed."""
    values = meminfo(subject.machine.text("/proc/meminfo"))
    if "MemAvailable" not in values:
        yield area.note("memory", "/proc/meminfo does not tell")
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
        text = f"{swapped / 1e6:.1f} GB are swapped out: what is needed again comes late"
        yield area.warning("swap", text, "end programs that take much memory, then: sudo swapoff -a && sudo swapon -a")


def need_mb(subject: Subject) -> float:
    """A rough need: the program itself, the pipeline's arrays, the frames that wait."""
    config = subject.config
    size = data_rate.image_size(subject, "left") or (1024, 820)
    waiting = 8 + (config.recording.queue + config.pipeline.queue if config is not None else 61)
    frames = (sum(data_rate.frame_bytes(subject)) or 2 * size[0] * size[1]) * waiting
    base = BASE_MB + (DEVICES_MB if subject.uses("genicam") or subject.uses("x11") else 0.0)
    before = config.recording.before_mb if config is not None and config.recording.before_s > 0 else 0
    return base + before + (size[0] * size[1] * ARRAYS_PER_PIXEL + frames) / 1e6


def meminfo(text: str) -> dict[str, int]:
    """The values of /proc/meminfo, kB."""
    found = {}
    for line in text.splitlines():
        name, _, value = line.partition(":")
        number = value.split()[:1]
        if number and number[0].isdigit():
            found[name.strip()] = int(number[0])
    return found
