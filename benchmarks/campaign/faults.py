"""The faults: each is applied to the rig, lasts, and is removed; the daemon must recover by itself."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from benchmarks.campaign import faulty_clients
from benchmarks.campaign.rig import CampaignRig, pause
from drivers.protocols import SIDES, Side
from fringed.errors import ControlError

Strike = Callable[[CampaignRig, random.Random], None]


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind: ``strike`` applies it and removes what a daemon cannot; ``new_daemon``: the process may be replaced."""

    name: str
    strike: Strike
    new_daemon: bool = False


def _side(random_: random.Random) -> Side:
    return random_.choice(SIDES)


def _end_daemon(number: signal.Signals) -> Strike:
    """End the daemon; the fault ends when the guard has started another one."""

    def strike(rig: CampaignRig, random_: random.Random) -> None:  # noqa: ARG001
        starts, end = rig.daemon.starts, time.monotonic() + 60.0
        rig.daemon.signal(number)
        while rig.daemon.starts == starts and time.monotonic() < end:
            pause(0.02)

    return strike


def _signal_child(word: str, number: signal.Signals) -> Strike:
    def strike(rig: CampaignRig, random_: random.Random) -> None:
        children = rig.daemon.children(word)
        if children:
            with suppress(ProcessLookupError):
                os.kill(random_.choice(children), number)

    return strike


def _freeze_child(word: str) -> Strike:
    def strike(rig: CampaignRig, random_: random.Random) -> None:
        children = rig.daemon.children(word)
        if children:
            pid = random_.choice(children)
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
                pause(random_.uniform(0.3, 3.0))
                os.kill(pid, signal.SIGCONT)

    return strike


def _freeze_daemon(rig: CampaignRig, random_: random.Random) -> None:
    rig.daemon.signal(signal.SIGSTOP)
    pause(random_.uniform(0.3, 3.0))
    rig.daemon.signal(signal.SIGCONT)


def _kill_x(rig: CampaignRig, random_: random.Random) -> None:
    server = rig.box.server
    assert server is not None
    server.kill()
    pause(random_.uniform(0.2, 1.0))
    server.restart()


def _unplug(count: int) -> Strike:
    def strike(rig: CampaignRig, random_: random.Random) -> None:
        sides = random_.sample(SIDES, count)
        for side in sides:
            rig.cables[side].unplug()
        pause(random_.uniform(0.2, 2.0))
        for side in sides:
            rig.cables[side].plug()

    return strike


def _on_cable(action: Callable[[CampaignRig, Side, random.Random], object]) -> Strike:
    def strike(rig: CampaignRig, random_: random.Random) -> None:
        action(rig, _side(random_), random_)
        pause(0.3)

    return strike


def _blackout(rig: CampaignRig, random_: random.Random) -> None:
    rig.dark.set()
    pause(random_.uniform(0.3, 2.0))
    rig.dark.clear()


def _disk(action: Callable[[CampaignRig], None]) -> Strike:
    def strike(rig: CampaignRig, random_: random.Random) -> None:
        action(rig)
        pause(random_.uniform(0.5, 2.0))
        rig.disk.mend()

    return strike


def _no_directory(rig: CampaignRig, random_: random.Random) -> None:
    """The directory of the takes is a file for a while."""
    with suppress(ControlError):
        rig.daemon.ask("record.stop", timeout_s=20.0)
    takes, away = rig.disk.takes, rig.disk.at / "kept"
    if takes.exists():
        takes.rename(away)
    takes.write_text("no directory")
    with suppress(ControlError):
        rig.daemon.ask("record.start", name="campaign", timeout_s=20.0)
    pause(random_.uniform(0.2, 0.5))
    takes.unlink()
    if away.exists():
        away.rename(takes)


def _step_clock(sign: int) -> Strike:
    def strike(rig: CampaignRig, random_: random.Random) -> None:
        rig.clock.set(rig.clock.shift_ns + sign * round(random_.uniform(0.5, 120.0) * 1e9))
        pause(0.3)

    return strike


def _reload(text: str) -> Strike:
    """The rig file is replaced by an invalid one, reloaded, and restored."""

    def strike(rig: CampaignRig, random_: random.Random) -> None:  # noqa: ARG001
        rig.box.rig_file.write_text(text)
        rig.daemon.signal(signal.SIGHUP)
        pause(0.5)
        rig.write_rig()
        rig.daemon.signal(signal.SIGHUP)

    return strike


def _settings(rig: CampaignRig, random_: random.Random) -> None:
    for _ in range(5):
        with suppress(ControlError):
            rig.daemon.ask("set", path="pipeline.settings.min_modulation", value=random_.choice([0.05, 0.06, "x", -1]))


def _pause(rig: CampaignRig, random_: random.Random) -> None:
    with suppress(ControlError):
        rig.daemon.ask("stop")
    pause(random_.uniform(0.1, 0.5))
    for _ in range(3):
        with suppress(ControlError):
            rig.daemon.ask("start")
            return


def _take_after_take(rig: CampaignRig, random_: random.Random) -> None:  # noqa: ARG001
    for _ in range(5):
        with suppress(ControlError):
            rig.daemon.ask("record.stop", timeout_s=20.0)
            rig.daemon.ask("record.start", name="campaign", timeout_s=20.0)


CAMERA, WINDOW = "drivers.remote.child", "drivers.projector.window_process.child"
SIGKILL, SIGTERM = signal.SIGKILL, signal.SIGTERM

FAULTS = (
    Fault("daemon killed", _end_daemon(SIGKILL), new_daemon=True),
    Fault("daemon terminated", _end_daemon(SIGTERM), new_daemon=True),
    Fault("daemon frozen, up to 3 s", _freeze_daemon),
    Fault("camera process killed", _signal_child(CAMERA, SIGKILL)),
    Fault("camera process frozen, up to 3 s", _freeze_child(CAMERA)),
    Fault("projector window killed", _signal_child(WINDOW, SIGKILL)),
    Fault("projector window frozen, up to 3 s", _freeze_child(WINDOW)),
    Fault("X server killed", _kill_x),
    Fault("one camera unplugged", _unplug(1)),
    Fault("both cameras unplugged", _unplug(2)),
    Fault("frames lost", _on_cable(lambda p, side, r: p.cables[side].drop(r.randint(1, 6)))),
    Fault("frames truncated", _on_cable(lambda p, side, r: p.cables[side].truncate(r.randint(1, 6)))),
    Fault("frames held back, up to 2 s", _on_cable(lambda p, side, r: p.cables[side].stall(r.uniform(0.1, 2.0)))),
    Fault("edges missed by one camera", _on_cable(lambda p, side, r: p.cables[side].swallow(r.randint(1, 6)))),
    Fault("edges doubled", _on_cable(lambda p, side, r: p.cables[side].double(r.randint(1, 6)))),
    Fault("no trigger, up to 2 s", _blackout),
    Fault(
        "camera clock set", _on_cable(lambda p, side, r: p.cables[side].set_clock(r.randint(-(10**10), 10**12), 20.0))
    ),
    Fault("clock of the day set forward", _step_clock(1)),
    Fault("clock of the day set back", _step_clock(-1)),
    Fault("disk full", _disk(lambda rig: rig.disk.fill())),
    Fault("disk read-only or directory gone", _disk(lambda rig: rig.disk.refuse())),
    Fault("disk pulled", _disk(lambda rig: rig.disk.pull())),
    Fault("a file where the takes should be", _no_directory),
    Fault("subscriber storm", faulty_clients.subscriber_storm),
    Fault("subscriber stopped", faulty_clients.stopped_subscriber),
    Fault("subscriber that never reads", faulty_clients.silent_subscriber),
    Fault("invalid data to both sockets", faulty_clients.invalid_data),
    Fault("status storm", faulty_clients.status_storm),
    Fault("rig file broken, SIGHUP", _reload("cameras: [")),
    Fault("rig file of another rig, SIGHUP", _reload("cameras: {driver: sim}\npairing: {tolerance_us: 10}\n")),
    Fault("settings, good and bad", _settings),
    Fault("paused and started", _pause),
    Fault("take after take", _take_after_take),
)
