"""Processors: how many there are for the pipeline, whether they run at full speed, and numba's threads."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common import threads

area = Area("processors")

_LAYERS = ("tbb", "tbbpool"), ("omp", "omppool"), ("workqueue", "workqueue")


def check(subject: Subject) -> Iterator[Finding]:
    """Count, rig.yaml's wishes, governor, numba."""
    available = threads.available()
    count = len(available)
    if count < 2:
        text = "1 processor for this process: pipeline, stream and recorder wait for each other"
        yield area.warning("count", text, "use a PC with four or more, or allow more (taskset, AllowedCPUs=)")
    else:
        yield area.ok("count", f"{count} of {os.cpu_count()} processors for this process")
    yield from wishes(subject, available)
    yield from governor(subject)
    yield numba_layer()


def wishes(subject: Subject, available: frozenset[int]) -> Iterator[Finding]:
    """``pipeline.cpus`` and ``pipeline.threads``."""
    if subject.config is None:
        return
    asked = subject.config.pipeline
    listed = ", ".join(map(str, sorted(available)))
    missing = sorted(set(asked.cpus) - available)
    if missing:
        text = f"pipeline.cpus names {', '.join(map(str, missing))}, which this process may not use"
        yield area.problem("cpus", text, f"set pipeline.cpus to some of: {listed}")
    elif asked.cpus and not available - set(asked.cpus):
        text = "pipeline.cpus leaves no processor for cameras, stream and recorder"
        yield area.warning("cpus", text, "leave one or two out of pipeline.cpus")
    most = len(set(asked.cpus) & available) or len(available)
    if asked.threads > most:
        text = f"pipeline.threads is {asked.threads}, there are {most} processors for it"
        yield area.warning("threads", text, f"set pipeline.threads to 0 (all) or at most {most}")


def governor(subject: Subject) -> Iterator[Finding]:
    """Processors that save power are late when a pair comes."""
    files = subject.machine.entries("/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    saving = [file for file in files if subject.machine.text(file) == "powersave"]
    # With intel_pstate and amd-pstate "powersave" is the ordinary, load-driven governor.
    driver = subject.machine.text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_driver")
    if saving and "pstate" not in driver:
        text = f"{len(saving)} processors are held at their lowest speed (governor powersave)"
        yield area.warning("governor", text, "sudo cpupower frequency-set -g performance")


def numba_layer() -> Finding:
    """The threading layer that numba will take: its own order is tbb, omp, workqueue."""
    import numba

    wanted = str(numba.config.THREADING_LAYER)
    names = []
    for layer, module in _LAYERS:
        try:
            importlib.import_module(f"numba.np.ufunc.{module}")
        except ImportError:
            continue
        names.append(layer)
    remedy = "install OpenMP's run time: sudo apt install libgomp1"
    if not names:
        return area.problem("numba", "numba has no threading layer: nothing can be reconstructed in parallel", remedy)
    if names == ["workqueue"]:
        return area.warning(
            "numba", "numba has only its workqueue, which ends the process when two threads use it", remedy
        )
    version, count = numba.__version__, numba.config.NUMBA_NUM_THREADS
    asked = f" (NUMBA_THREADING_LAYER={wanted})" if wanted != "default" else ""
    return area.ok("numba", f"numba {version}: {count} threads, threading layers {', '.join(names)}{asked}")
