"""Names and processors of threads, as the operating system has them."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from daemon.common import threads


def comm(thread: int) -> str:
    return Path(f"/proc/self/task/{thread}/comm").read_text().strip()


def test_every_thread_gets_its_name_and_those_it_makes_inherit_it() -> None:
    go, inner = threading.Event(), []

    def outer() -> None:
        threads.name(threading.get_native_id(), "a-long-name-of-a-thread")
        child = threading.Thread(target=lambda: inner.append(comm(threading.get_native_id())))
        child.start()
        child.join()
        go.wait(20)

    thread = threading.Thread(target=outer, name="plain")
    thread.start()
    while not inner:
        thread.join(0.01)
    assert inner == ["a-long-name-of-"]
    namer, before = threads.ThreadNamer("program"), comm(os.getpid())
    namer.update()
    assert thread.native_id is not None
    assert comm(thread.native_id) == "plain" and comm(os.getpid()) == "program"
    assert thread.native_id in threads.ids()
    threads.name(os.getpid(), before)
    go.set()
    thread.join()
    threads.name(thread.native_id, "nobody")


def test_an_unnamed_thread_of_a_library_is_named_after_its_class() -> None:
    class Sweeper(threading.Thread):
        go = threading.Event()

        def run(self) -> None:
            self.go.wait(20)

    thread = Sweeper()
    thread.start()
    before = comm(os.getpid())
    threads.ThreadNamer(before).update()
    assert thread.native_id is not None and comm(thread.native_id) == "Sweeper"
    thread.go.set()
    thread.join()


def test_a_pinned_thread_passes_its_processors_on() -> None:
    cpu = min(threads.available())
    seen: list[frozenset[int]] = []

    def pinned() -> None:
        threads.pin([threading.get_native_id()], [cpu])
        child = threading.Thread(target=lambda: seen.append(threads.available()))
        child.start()
        child.join()

    thread = threading.Thread(target=pinned)
    thread.start()
    thread.join()
    assert seen == [frozenset({cpu})]
