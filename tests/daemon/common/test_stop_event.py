"""A request to stop reaches all waiting threads, also from a signal handler at any moment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

from daemon.common.stop_event import StopEvent


def test_waiting_threads_are_woken_and_later_ones_do_not_wait() -> None:
    stop, woken = StopEvent(), []
    threads = [threading.Thread(target=lambda: woken.append(stop.wait(30.0))) for _ in range(4)]
    for thread in threads:
        thread.start()
    stop.set()
    stop.set()
    for thread in threads:
        thread.join(20)
    assert woken == [True] * 4 and stop.wait(30.0) and stop.is_set()


def test_waiting_ends_by_itself_too() -> None:
    assert not StopEvent().wait(0.0)


_STORM = """
import os, signal, sys, threading
from daemon.common.stop_event import StopEvent

stops = [StopEvent() for _ in range(200)]
at = [0]

def handle(*_):
    stops[at[0]].set()

signal.signal(signal.SIGUSR1, handle)
for i, stop in enumerate(stops):
    at[0] = i
    sender = threading.Thread(target=lambda: os.kill(os.getpid(), signal.SIGUSR1))
    sender.start()
    while not stop.wait(0.0005):
        pass
    sender.join()
print("all came")
"""


def test_a_handler_that_interrupts_the_waiting_thread_never_hangs_it() -> None:
    done = subprocess.run([sys.executable, "-c", _STORM], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "all came\n"


def test_its_descriptor_is_closed() -> None:
    stop = StopEvent()
    fd = stop._fd
    os.fstat(fd)
    del stop
    again = StopEvent()
    assert again._fd == fd and signal.getsignal(signal.SIGUSR1) is signal.SIG_DFL
