"""The disk of the recordings: room, and a short measurement of how fast it writes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.places import existing

area = Area("disk")

MAX_BYTES, MAX_S = 256 << 20, 3.0
_BLOCK, _SYNC_BYTES = 4 << 20, 16 << 20
_MIN_RECORDING_S = 60.0
_LITTLE_MB = 5000.0
_MIN_RATE_HZ = 10.0
_ELSEWHERE = "set recording.dir to a directory on another disk"


def check(subject: Subject) -> Iterator[Finding]:
    """Directory, room, speed."""
    config = subject.config
    directory = config.path(config.recording.dir, subject.base_dir) if config is not None else Path.cwd()
    above = existing(directory)
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        yield area.problem("directory", f"{directory} cannot be written", f"sudo chown $USER {above}, or {_ELSEWHERE}")
        return
    stats = os.statvfs(above)
    free_mb = stats.f_bavail * stats.f_frsize / 1e6
    keep_mb = float(config.recording.min_free_mb) if config is not None else 0.0
    pair_mb, rate = sum(data_rate.frame_bytes(subject)) / 1e6, data_rate.rate_hz(subject)
    yield room(directory, free_mb, keep_mb, pair_mb * rate)
    if free_mb < 64:
        return
    yield speed(measure(above, min(MAX_BYTES, int(free_mb * 1e6 / 20))), pair_mb, rate)


def room(directory: Path, free_mb: float, keep_mb: float, need_mb_s: float) -> Finding:
    """Free space above recording.min_free_mb, in seconds of recording where the rate is known."""
    usable = free_mb - keep_mb
    text = f"{directory}: {free_mb / 1e3:.1f} GB free"
    if usable <= 0:
        text += f", less than recording.min_free_mb ({keep_mb:.0f}): nothing would be recorded"
        return area.problem("room", text, f"delete old takes, or {_ELSEWHERE}")
    lasts = usable / need_mb_s if need_mb_s > 0 else None
    if lasts is not None:
        text += f", at least {_duration(lasts)} of recording"
    if (lasts is not None and lasts < _MIN_RECORDING_S) or (lasts is None and usable < _LITTLE_MB):
        return area.warning("room", text, f"delete old takes, or {_ELSEWHERE}")
    return area.ok("room", text)


def speed(mb_s: float, pair_mb: float, rate_hz: float) -> Finding:
    """Speed against what two cameras send, without compression."""
    text = f"writes {mb_s:.0f} MB/s"
    if pair_mb <= 0 or mb_s <= 0:
        return area.ok("speed", text) if mb_s > 0 else area.note("speed", "too slow or too full to measure")
    if rate_hz > 0:
        text += f"; {rate_hz:g} pairs/s of {pair_mb:.1f} MB are {pair_mb * rate_hz:.0f} MB/s before compression"
    else:
        text += f", enough for {mb_s / pair_mb:.0f} pairs/s of {pair_mb:.1f} MB before compression"
    if mb_s < pair_mb * (rate_hz or _MIN_RATE_HZ):
        return area.warning("speed", f"{text}: recording may lose pairs", f"{_ELSEWHERE} (SSD), or lower the rate")
    return area.ok("speed", text)


def measure(directory: Path, limit: int) -> float:
    """MB/s of writing with fsync to a file that nobody sees; it ends after ``limit`` bytes or three seconds."""
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
