"""``python -m benchmarks.campaign``: random faults against a whole rig on emulated hardware, one after the other.

A daemon under a guard that restarts it as systemd would measures and records a rig in a box, with the real drivers; the
faults of :mod:`benchmarks.campaign.faults` are applied in an order of the seed. A fault is survived when clouds flow
again, from the same process unless the process itself was the target. Every take is read to its end and each of its
pairs compared byte by byte with what was shown. The exit code is 1 when anything was not survived or a pair is wrong.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from benchmarks.campaign.faults import FAULTS, Fault
from benchmarks.campaign.report import Campaign, Outcome
from benchmarks.campaign.rig import RECOVERY_S, CampaignRig, pause
from benchmarks.campaign.takes import first_part, last_shown, stem_of
from benchmarks.common.daemon_process import tree
from benchmarks.common.process_statistics import sample
from daemon.common.files import write_atomically
from daemon.recording.format.errors import TakeError
from fringed.errors import ControlError

_READ_EVERY = 20
_KILLED = "daemon killed"


def run(rig: CampaignRig, order: list[Fault], random_: random.Random, *, verbose: bool) -> Campaign:
    """Apply each fault, wait and note its outcome; read the takes now and then."""
    campaign, started_s = Campaign(), time.monotonic()
    for number, fault in enumerate(order):
        if rig.ensure_recording():
            pause(1.0)
            rig.ensure_recording()
        outcome = _strike(rig, fault, random_, campaign)
        campaign.outcomes.append(outcome)
        if verbose:
            recovery = "NEVER" if outcome.recovery_s is None else f"{outcome.recovery_s:.2f} s"
            print(f"{number + 1}/{len(order)} {fault.name}: {recovery}, {outcome.lost} lost"
                  f"{'' if outcome.survived else ' NOT SURVIVED'}", flush=True)  # fmt: skip
        if number % _READ_EVERY == _READ_EVERY - 1 or number == len(order) - 1:
            _read_takes(rig, campaign)
            campaign.memory_mib.append(_memory_mib(rig))
    campaign.triggers, campaign.clouds = rig.triggers, rig.watcher.clouds
    campaign.seconds = time.monotonic() - started_s
    return campaign


def _strike(rig: CampaignRig, fault: Fault, random_: random.Random, campaign: Campaign) -> Outcome:
    writing = _writing(rig) if fault.name == _KILLED else ""
    starts, triggers, clouds = rig.daemon.starts, rig.triggers, rig.watcher.clouds
    struck_ns = time.monotonic_ns()
    fault.strike(rig, random_)
    recovery_s = rig.watcher.after(time.monotonic(), RECOVERY_S)
    lost = rig.triggers - triggers - (rig.watcher.clouds - clouds)
    survived = recovery_s is not None and (fault.new_daemon or rig.daemon.starts == starts)
    if writing:
        _note_missing(rig, writing, struck_ns, campaign)
    return Outcome(fault.name, survived, max(lost, 0), recovery_s)


def _writing(rig: CampaignRig) -> str:
    """The take that is being written, as the stem of its files."""
    with suppress(ControlError):
        recorder = rig.daemon.ask("status")["recorder"]
        if recorder.get("recording") and recorder.get("file"):
            return stem_of(Path(recorder["file"]))
    return ""


def _note_missing(rig: CampaignRig, stem: str, struck_ns: int, campaign: Campaign) -> None:
    """How long before the kill the last pair of the take was exposed."""
    path = first_part(rig.disk.takes, stem)
    with suppress(TakeError, OSError):
        last = last_shown(path, rig.box.world.ledger)
        if last is not None:
            campaign.missing_s.append(max(0.0, (struck_ns - last.t_ns) / 1e9))


def _read_takes(rig: CampaignRig, campaign: Campaign) -> None:
    with suppress(ControlError):
        rig.daemon.ask("record.stop", timeout_s=30.0)
    campaign.takes.read(rig.disk.takes, rig.box.world.ledger, writing=_writing(rig))


def _memory_mib(rig: CampaignRig) -> float:
    total = 0.0
    for pid in tree(rig.daemon.pid):
        with suppress(OSError, KeyError):
            total += sample(pid, 0.0).own_mib
    return total


def arguments(given: list[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign", description=__doc__)
    parser.add_argument("--faults", type=int, default=504, help="how many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=0.125, help="size of the images, 1 = 1024 x 820")
    parser.add_argument("--rate", type=float, default=10.0, help="triggers a second")
    parser.add_argument("--only", help="faults whose names have this word")
    parser.add_argument("--verbose", action="store_true", help="report each fault")
    parser.add_argument("--out", type=Path, default=Path("out"), help="directory of campaign.json")
    return parser.parse_args(given)


def order_of(count: int, random_: random.Random, only: str | None = None) -> list[Fault]:
    """Every kind equally often, in any order."""
    kinds = [fault for fault in FAULTS if only is None or only in fault.name]
    order: list[Fault] = []
    while len(order) < count:
        order += random_.sample(kinds, len(kinds))
    return order[:count]


def main(given: list[str]) -> int:
    """Run, print, store."""
    options = arguments(given)
    random_ = random.Random(options.seed)
    order = order_of(options.faults, random_, options.only)
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="campaign-") as directory:
        with CampaignRig(Path(directory), scale=options.scale, rate_hz=options.rate) as rig:
            campaign = run(rig, order, random_, verbose=options.verbose)
        (options.out / "campaign.log").write_bytes((Path(directory) / "daemon.log").read_bytes())
    write_atomically(options.out / "campaign.json", (json.dumps(campaign.as_dict(), indent=1) + "\n").encode())
    print(campaign.markdown())
    print("\n".join(f"NOT GOOD: {problem}" for problem in campaign.problems()) or "good: everything survived")
    return 1 if campaign.problems() else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
