"""A daemon on a rig in a box, with its real service and drivers, and a check that identifies every pair."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import yaml

from daemon.bootstrap.sinks import open_publisher
from daemon.config import load_rig
from daemon.live.items import CloudItem, Item, Pair, Sink
from daemon.live.service import Service
from daemon.rig.open_rig import open_rig
from drivers.protocols import SIDES
from sim.box.box import Box
from sim.box.exposure_ledger import Ledger, Trigger
from tools.waiting import wait_until


class PairCheck:
    """A sink that identifies the exposures of every pair's frames by their bytes.

    ``counts``: ``pairs`` that are right (``lit`` or ``dark``), ``wrong`` ones of two exposures, ``unknown`` ones with a
    frame that was never shown, ``clouds``.

    Args:
        ledger: of the world; report: called for each right pair and each cloud, with the exposure and the time
            (CLOCK_MONOTONIC, ns) at which it was offered, before its bytes were compared.
    """

    heartbeat = None

    def __init__(self, ledger: Ledger, report: Callable[[Trigger, Item, int], None] | None = None) -> None:
        self._ledger = ledger
        self._report = report
        self.counts: Counter[str] = Counter()
        self.last_pair = self.last_cloud = -1

    def offer(self, item: Item) -> bool:
        """Identify a pair or a cloud."""
        now_ns = time.monotonic_ns()
        if isinstance(item, Pair):
            shown = {side: self._ledger.exposure_of(side, getattr(item, side).image) for side in SIDES}
            left, right = shown["left"], shown["right"]
            if left is None or right is None:
                self.counts["unknown"] += 1
            elif left.index != right.index:
                self.counts["wrong"] += 1
            else:
                self.counts["pairs"] += 1
                self.counts["dark" if left.dark else "lit"] += 1
                self._report_exposure(left, item, now_ns)
                self.last_pair = left.index
        elif isinstance(item, CloudItem):
            self.counts["clouds"] += 1
            shown_left = self._ledger.exposure_of("left", item.left.image)
            if shown_left is not None:
                self._report_exposure(shown_left, item, now_ns)
                self.last_cloud = shown_left.index
        return True

    def close(self) -> None:
        """Do nothing."""

    def status(self) -> dict[str, Any]:
        """The counts."""
        return dict(self.counts)

    def _report_exposure(self, shown: Trigger, item: Item, now_ns: int) -> None:
        if self._report is not None:
            self._report(shown, item, now_ns)


class Daemon:
    """The service on a box, running in a thread of this process; for ``with``.

    The environment variable of :mod:`sim.box.box` must name the box's cameras.

    Args:
        box: open; report: see :class:`PairCheck`; pipeline: changes to that section of rig.yaml.
    """

    def __init__(
        self, box: Box, *, report: Callable[[Trigger, Item, int], None] | None = None, **pipeline: Any
    ) -> None:
        self._box, self._report = box, report
        rig = yaml.safe_load(box.rig_file.read_text())
        box.rig_file.write_text(yaml.safe_dump(rig | {"pipeline": {"queue": 4, "temporal_prior": False} | pipeline}))
        self.stream = rig["stream"]["endpoints"][0]
        self.errors: list[BaseException] = []

    def __enter__(self) -> Daemon:
        with ExitStack() as stack:
            config = load_rig(self._box.rig_file)
            self.rig = open_rig(config, self._box.folder)
            stack.callback(self.rig.release)
            publisher = open_publisher(config, self.rig, "box")
            self.pair_check = PairCheck(self._box.world.ledger, self._report)
            sinks: dict[str, Sink] = {"stream": publisher, "pair check": self.pair_check}
            self.service = Service(config, self.rig, sinks, on_status=publisher.publish_status, session="box")
            self._thread = threading.Thread(target=self._run, name="daemon")
            self._thread.start()
            stack.callback(self.stop)
            wait_until(lambda: self.state() == "running", 90, "the daemon")
            self.wait_armed()
            stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._check()

    def stop(self) -> None:
        """End the service; may be called twice."""
        self.service.request_stop()
        self._thread.join(60)
        if self._thread.is_alive():
            raise TimeoutError("the daemon does not end within 60 s")

    def state(self) -> str:
        """State of the daemon."""
        self._check()
        return str(self.service.state()[0])

    def reasons(self) -> str:
        """Why it is degraded."""
        return "; ".join(self.service.state()[1])

    def wait_armed(self, timeout_s: float = 60) -> None:
        """Until both cameras wait for a trigger."""
        cables = self._box.cables
        wait_until(lambda: all(cables[side].state().armed for side in SIDES), timeout_s, "cameras armed")

    def step_until_pair(self, tries: int = 40) -> int:
        """Triggers until the daemon has paired one, as it must within a few; the trigger's index.

        A camera that was restarted while its numbers are still low repeats numbers that the pairing remembers: it
        takes up to 16 triggers more until the pairing distinguishes them.
        """
        for _ in range(tries):
            index = self._box.world.step().index
            end = time.monotonic() + 0.5
            while self.pair_check.last_pair < index and time.monotonic() < end and self._confirmed:
                time.sleep(0.0005)
            if self.pair_check.last_pair == index:
                return index
            time.sleep(0.01)
        raise TimeoutError(f"no pair within {tries} triggers; {self.service.status()}")

    def step_patiently(self, count: int = 1, *, patience_s: float = 0.1) -> None:
        """Triggers, each followed by a wait for its pair, so that only faults lose anything."""
        for _ in range(count):
            index = self._box.world.step().index
            end = time.monotonic() + patience_s
            while self.pair_check.last_pair < index and time.monotonic() < end:
                time.sleep(0.0002)

    def _check(self) -> None:
        if self.errors:
            raise RuntimeError("the daemon ended with an error") from self.errors[0]

    @property
    def _confirmed(self) -> bool:
        """Whether the pairing has confirmed its count, so that the next pair is delivered at once."""
        return bool(self.service.pairer._pairer._confirmed)

    def _run(self) -> None:
        try:
            self.service.run()
        except BaseException as error:
            logging.getLogger("benchmarks.box").exception("the daemon ended")
            self.errors.append(error)
