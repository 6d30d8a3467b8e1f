"""The disk of the recordings: free space, and a short measurement of its write speed."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.files import existing_parent

area = Area("disk")

MAX_BYTES, MAX_S = 256 << 20, 3.0
_BLOCK, _SYNC_BYTES = 4 << 20, 16 << 20
_MIN_RECORDING_S = 60.0
_LITTLE_MB = 5000.0
_MIN_RATE_HZ = 10.0
_ELSEWHERE = "set recording.dir to a directory on another disk"


def check(subject: Subject) -> Iterator[Finding]:
    """Check directory, free space and write speed."""
    config = subject.config
    directory = config.path(config.recording.dir, subject.base_dir) if config is not None else Path.cwd()
    parent = existing_parent(directory)
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        yield area.problem("directory", f"{directory} is not writable", f"sudo chown $USER {parent}, or {_ELSEWHERE}")
        return
    stats = os.statvfs(parent)
    free_mb = stats.f_bavail * stats.f_frsize / 1e6
    keep_mb = float(config.recording.min_free_mb) if config is not None else 0.0
    pair_mb, rate = sum(data_rate.frame_bytes(subject)) / 1e6, data_rate.rate_hz(subject)
    yield room(directory, free_mb, keep_mb, pair_mb * rate)
    if free_mb < 64:
        return
    yield speed(measure(parent, min(MAX_BYTES, int(free_mb * 1e6 / 20))), pair_mb, rate)


def room(directory: Path, free_mb: float, keep_mb: float, need_mb_s: float) -> Finding:
    """Check the free space above recording.min_free_mb, as a duration of recording if the rate is known."""
    usable = free_mb - keep_mb
    text = f"{directory}: {free_mb / 1e3:.1f} GB free"
    if usable <= 0:
        text += f", less than recording.min_free_mb ({keep_mb:.0f}): recording would not start"
        return area.problem("room", text, f"delete old takes, or {_ELSEWHERE}")
    duration_s = usable / need_mb_s if need_mb_s > 0 else None
    if duration_s is not None:
        text += f", at least {_duration(duration_s)} of recording"
    if usable < _LITTLE_MB if duration_s is None else duration_s < _MIN_RECORDING_S:
        return area.warning("room", text, f"delete old takes, or {_ELSEWHERE}")
    return area.ok("room", text)


def speed(mb_s: float, pair_mb: float, rate_hz: float) -> Finding:
    """Compare the write speed with the uncompressed data rate of two cameras."""
    text = f"writes {mb_s:.0f} MB/s"
    if pair_mb <= 0 or mb_s <= 0:
        return (
            area.ok("speed", text)
            if mb_s > 0
            else area.note("speed", "the disk is too slow or too full for the measurement")
        )
    if rate_hz > 0:
        text += f"; {rate_hz:g} pairs/s of {pair_mb:.1f} MB are {pair_mb * rate_hz:.0f} MB/s before compression"
    else:
        text += f", enough for {mb_s / pair_mb:.0f} pairs/s of {pair_mb:.1f} MB before compression"
    if mb_s < pair_mb * (rate_hz or _MIN_RATE_HZ):
        return area.warning("speed", f"{text}: recording may lose pairs", f"{_ELSEWHERE} (SSD), or lower the rate")
    return area.ok("speed", text)


def measure(directory: Path, limit: int) -> float:
    """Measure MB/s of writing with fsync to an unnamed file, for up to ``limit`` bytes or three seconds."""
    block = memoryview(os.urandom(_BLOCK))  # some file systems would compress zeros
    written = 0
    with tempfile.TemporaryFile(dir=directory, prefix=".fringed-doctor-", buffering=0) as file:
        start = time.monotonic()
        while written + _BLOCK <= limit and time.monotonic() - start < MAX_S:
            written += file.write(block)
            if written % _SYNC_BYTES == 0:
                os.fsync(file.fileno())
        os.fsync(file.fileno())
        return written / 1e6 / max(time.monotonic() - start, 1e-9)


def _duration(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 120
        else f"{seconds / 60:.0f} minutes"
        if seconds < 7200
        else f"{seconds / 3600:.0f} hours"
    )
