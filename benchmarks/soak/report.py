"""Result of a soak run: losses by reason, growth of memory, percentiles, and the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common.process_statistics import Sample

#: Memory may grow so much between the two parts of a run that are compared: a few clouds on their way.
GROWTH_MIB = 48.0
#: Share of the wanted triggers that must have been given; a slower machine measures something else.
TRIGGERS = 0.98
#: Reasons for which a pair becomes no cloud, as the daemon counts them.
PIPELINE_DROPS = (
    "pairs_not_ready", "pairs_pipeline_busy", "pairs_refused_by_pipeline", "pairs_failed_in_pipeline", "pairs_stopped",
)  # fmt: skip
#: Pairs that may be under way when the last status is taken.
_UNDER_WAY = 3


def growth(samples: Sequence[Sample]) -> dict[str, float]:
    """Growth of the process's own memory, MiB: the second fifth of the run against the last one, and the slope."""
    if len(samples) < 10:
        return {"early_mib": 0.0, "late_mib": 0.0, "slope_mib_per_hour": 0.0}
    own = np.array([s.own_mib for s in samples])
    hours = np.array([s.t_s for s in samples]) / 3600
    n = len(own)
    steady = slice(n // 5, None)
    return {
        "early_mib": round(median(own[n // 5 : 2 * n // 5].tolist()), 2),
        "late_mib": round(median(own[4 * n // 5 :].tolist()), 2),
        "slope_mib_per_hour": round(float(np.polyfit(hours[steady], own[steady], 1)[0]), 2),
    }


def losses(first: Mapping[str, Any], last: Mapping[str, Any], gaps: Mapping[str, int]) -> dict[str, int]:
    """Pairs and clouds that were lost between two statuses of the daemon, by reason.

    Args:
        gaps: by topic the numbers that its reader never received.
    """
    found = _differences("", first["drops"], last["drops"])
    dropped = sum(count for name, count in found.items() if name in PIPELINE_DROPS)
    for side, camera in last["cameras"].items():
        outcomes = {name: count for name, count in camera["fates"].items() if name not in ("paired", "waiting")}
        found |= _differences(f"frames_{side}_", first["cameras"][side]["fates"], outcomes)
    found |= _differences("recorder_", first["recorder"].get("dropped", {}), last["recorder"].get("dropped", {}))
    found["stream_overtaken"] = last["sinks"]["stream"]["dropped"] - first["sinks"]["stream"]["dropped"]
    for topic, count in gaps.items():
        found[f"{topic}_not_received"] = max(0, count - dropped - found["stream_overtaken"])
    under_way = (last["pairs"] - last["clouds"]) - (first["pairs"] - first["clouds"]) - dropped
    found["pairs_unaccounted"] = max(0, abs(under_way) - _UNDER_WAY)
    return {name: count for name, count in found.items() if count}


def _differences(prefix: str, before: Mapping[str, int], after: Mapping[str, int]) -> dict[str, int]:
    return {prefix + name: count - before.get(name, 0) for name, count in after.items()}


def percentiles(values: Sequence[float]) -> dict[str, float]:
    """p50, p99, p999 and max of milliseconds; empty without values."""
    if not values:
        return {}
    shares = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
    return {name: round(float(np.percentile(values, share)), 2) for name, share in shares.items()}


def cpu_ms_per_pair(samples: Sequence[Sample], pairs: int) -> dict[str, float]:
    """Processor time of each pair by name of thread, ms, the largest first."""
    if len(samples) < 2 or pairs <= 0:
        return {}
    before, after = samples[0].cpu_s, samples[-1].cpu_s
    spent = {name: 1e3 * (s - before.get(name, 0.0)) / pairs for name, s in after.items()}
    return {name: round(ms, 2) for name, ms in sorted(spent.items(), key=lambda item: -item[1]) if ms >= 0.005}


def page_faults(first: Mapping[str, Any], last: Mapping[str, Any], pairs: int) -> dict[str, float]:
    """Page faults of the daemon between two statuses, for each pair, and those while a pair was measured."""
    before, after = first["memory"], last["memory"]
    kinds = ("minor_faults", "major_faults")
    per_pair = {f"{kind} per pair": round((after[kind] - before[kind]) / max(1, pairs), 2) for kind in kinds}
    return per_pair | {name: value for name, value in after.items() if name not in kinds}


def _times(slowest: Mapping[str, Any]) -> str:
    parts = ("latency", "arrival", "waiting", "measuring")
    whole = [f"{part} {slowest[f'{part}_ms']:.1f}" for part in parts if slowest]
    stages = [f"{name} {ms:.1f}" for name, ms in slowest.get("stages_ms", {}).items()]
    return ", ".join(whole + stages)


def verdict(result: Mapping[str, Any]) -> list[str]:
    """Violated limits; empty = all good."""
    return list(_faults(result))


def _faults(result: Mapping[str, Any]) -> Iterator[str]:
    if result["losses"]:
        reasons = ", ".join(f"{name} {count}" for name, count in result["losses"].items())
        yield f"lost: {reasons}"
    memory = result["memory"]
    if memory["late_mib"] - memory["early_mib"] > GROWTH_MIB:
        yield f"memory grew from {memory['early_mib']:.0f} to {memory['late_mib']:.0f} MiB"
    if result["pairs"] < TRIGGERS * result["rate_hz"] * result["seconds"]:
        yield f"{result['pairs']} pairs came in {result['seconds']:.0f} s, expected {result['rate_hz']:g} a second"
    if result["problems"]:
        yield "; ".join(result["problems"])
    if result["exit_status"] != 0:
        yield f"the daemon ended with exit status {result['exit_status']}"


def show(result: Mapping[str, Any], console: Console) -> None:
    """Print it as tables."""
    table = Table(title=f"Soak: {result['seconds']:.0f} s at {result['rate_hz']:g} pairs a second", show_header=False)
    memory = result["memory"]
    for name, value in (
        ("pairs, clouds", f"{result['pairs']}, {result['clouds']} ({result['points']} points in the last one)"),
        ("lost, by reason", ", ".join(f"{k} {v}" for k, v in result["losses"].items()) or "nothing"),
        ("lost while starting", ", ".join(f"{k} {v}" for k, v in result["losses_at_start"].items()) or "nothing"),
        ("recorded", f"{result['recorded_pairs']} pairs, {result['recorded_bytes'] / 1e9:.1f} GB"),
        ("memory of its own, early and late", f"{memory['early_mib']:.0f} and {memory['late_mib']:.0f} MiB"),
        ("slope", f"{memory['slope_mib_per_hour']:+.1f} MiB an hour"),
        ("resident, largest", f"{memory['rss_max_mib']:.0f} MiB"),
        ("garbage collections", ", ".join(f"{k} {v:g}" for k, v in result["garbage"].items())),
        ("slowest pair, ms", _times(result["slowest"])),
        ("page faults", ", ".join(f"{k} {v:g}" for k, v in result["page_faults"].items())),
    ):
        table.add_row(name, value)
    console.print(table)
    latency = Table(title="Latency, ms")
    for heading in ("from .. to", "p50", "p99", "p999", "max"):
        latency.add_column(heading, justify="left" if heading == "from .. to" else "right")
    for name, values in result["latency_ms"].items():
        shown = [f"{values[key]:.1f}" if key in values else "" for key in ("p50", "p99", "p999", "max")]
        latency.add_row(name, *shown)
    console.print(latency)
    cpu = Table(title="Processor time of a pair, by thread")
    cpu.add_column("thread")
    cpu.add_column("ms", justify="right")
    for name, ms in result["cpu_ms_per_pair"].items():
        cpu.add_row(name, f"{ms:.2f}")
    console.print(cpu)
