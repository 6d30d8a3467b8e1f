"""The status in one line."""

from __future__ import annotations

from typing import Any

from daemon.common.processor_share import SCARCE


def line(status: dict[str, Any]) -> str:
    """State, rate, points, latency and drops."""
    latency = status["latency_ms"]
    timing = f"latency {latency['p50']:.0f} ms (95 %: {latency['p95']:.0f} ms)" if latency else "no cloud yet"
    starting, dropped = _dropped(status)
    return (
        f"{status['state']}: {status['cloud_rate_hz']:.1f} clouds/s of {status['pair_rate_hz']:.1f} pairs/s, "
        f"{status['points']} points, {timing}, dropped {dropped}{f' ({starting} while starting)' if starting else ''}"
    )


def loading(status: dict[str, Any]) -> str:
    """What a starting daemon does about its kernels."""
    kernels = status.get("kernels", {})
    ready, total = kernels.get("ready", 0), kernels.get("total", 0)
    return f"starting: compiling kernels, {ready} of {total}" if ready < total else "starting: loading the kernels"


def waiting(status: dict[str, Any]) -> str:
    """What the first cloud waits for."""
    if status["state"] in ("paused", "stopping"):
        return f"{status['state']}; no cloud yet"
    cameras: dict[str, dict[str, Any]] = status["cameras"]
    lost = [f"camera {side}: {camera['problem']}" for side, camera in cameras.items() if camera["problem"]]
    if lost:
        return f"waiting for {'; '.join(lost)}"
    unopened = [side for side, camera in cameras.items() if not camera["encoding"]]
    if unopened:
        return f"starting: opening camera {' and '.join(unopened)}"
    if status["state"] == "starting":
        return loading(status)
    silent = [side for side, camera in cameras.items() if not camera["frames"]]
    if silent:
        return f"waiting for the trigger: no frame from camera {' and '.join(silent)} yet"
    return f"frames come, {status['pairs']} pairs, but no cloud yet; dropped {_dropped(status)[1]}"


def describe(status: dict[str, Any]) -> str:
    """One line for the service manager, with the problems at its end."""
    text = line(status) if status["clouds"] else waiting(status)
    short = [f"gets {100 * share:.0f} % of the processor time it needs"] if (share := _share(status)) < SCARCE else []
    reasons = "; ".join([*status["reasons"], *short])
    return f"{text}; {reasons}" if reasons and reasons not in text else text


def _share(status: dict[str, Any]) -> float:
    """Of the processor time that the daemon needs and gets."""
    return float(status.get("processors", {}).get("share", 1.0))


def _dropped(status: dict[str, Any]) -> tuple[int, int]:
    """How much was dropped while the daemon started, and since then."""
    starting = sum(status.get("drops_starting", {}).values())
    return starting, sum(status["drops"].values()) - starting
