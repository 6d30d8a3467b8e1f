"""Processors for the pipeline, their speed, and numba's threading layers."""

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
    """Check the number of processors, rig.yaml's requests, the governor and numba."""
    available = threads.available()
    count = len(available)
    if count < 2:
        text = "1 processor for this process: pipeline, stream and recorder share it"
        yield area.warning("count", text, "use a PC with four or more, or allow more (taskset, AllowedCPUs=)")
    else:
        yield area.ok("count", f"{count} of {os.cpu_count()} processors for this process")
    yield from requested_cpus(subject, available)
    yield from governor(subject)
    yield numba_layer()


def requested_cpus(subject: Subject, available: frozenset[int]) -> Iterator[Finding]:
    """Check ``pipeline.cpus`` and ``pipeline.threads``."""
    if subject.config is None:
        return
    pipeline = subject.config.pipeline
    listed = ", ".join(map(str, sorted(available)))
    missing = sorted(set(pipeline.cpus) - available)
    if missing:
        text = f"pipeline.cpus names {', '.join(map(str, missing))}, which this process cannot use"
        yield area.problem("cpus", text, f"set pipeline.cpus to processors of: {listed}")
    elif pipeline.cpus and not available - set(pipeline.cpus):
        text = "pipeline.cpus leaves no processor for cameras, stream and recorder"
        yield area.warning("cpus", text, "remove one or two from pipeline.cpus")
    most = len(set(pipeline.cpus) & available) or len(available)
    if pipeline.threads > most:
        text = f"pipeline.threads is {pipeline.threads}, but {most} processors are available"
        yield area.warning("threads", text, f"set pipeline.threads to 0 (all) or at most {most}")


def governor(subject: Subject) -> Iterator[Finding]:
    """Check for a power-saving governor, which delays the processing of a pair."""
    files = subject.machine.entries("/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    slow = [file for file in files if subject.machine.text(file) == "powersave"]
    # With intel_pstate and amd-pstate "powersave" is the normal, load-driven governor.
    driver = subject.machine.text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_driver")
    if slow and "pstate" not in driver:
        text = f"{len(slow)} processors are fixed at their lowest frequency (governor powersave)"
        yield area.warning("governor", text, "sudo cpupower frequency-set -g performance")


def numba_layer() -> Finding:
    """Check the threading layers of numba; its order of preference is tbb, omp, workqueue."""
    import numba

    configured = str(numba.config.THREADING_LAYER)
    names = []
    for layer, module in _LAYERS:
        try:
            importlib.import_module(f"numba.np.ufunc.{module}")
        except ImportError:
            continue
        names.append(layer)
    remedy = "install the OpenMP runtime: sudo apt install libgomp1"
    if not names:
        return area.problem("numba", "numba has no threading layer: the pipeline cannot run in parallel", remedy)
    if names == ["workqueue"]:
        return area.warning(
            "numba", "numba has only the layer workqueue, which ends the process when two threads use it", remedy
        )
    version, count = numba.__version__, numba.config.NUMBA_NUM_THREADS
    setting = f" (NUMBA_THREADING_LAYER={configured})" if configured != "default" else ""
    return area.ok("numba", f"numba {version}: {count} threads, threading layers {', '.join(names)}{setting}")
