"""The status as rows and as a table of text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from daemon.bootstrap.systemd.status_line import waiting


def table(status: dict[str, Any]) -> str:
    """The status as a table of text."""
    from io import StringIO

    from rich.console import Console
    from rich.table import Table

    shown = Table(show_header=False, box=None, pad_edge=False)
    shown.add_column(style="bold")
    shown.add_column()
    for name, value in rows(status):
        shown.add_row(name, value)
    console = Console(file=StringIO(), width=110)
    console.print(shown)
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in text.splitlines())


def rows(status: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of every line of the table."""
    latency, published = status["latency_ms"], status["publish_latency_ms"]
    out = [
        ("state", f"{status['state']}{''.join(f'; {reason}' for reason in status['reasons'])}"),
        *([] if status["clouds"] else [("first cloud", waiting(status))]),
        *(("warning", warning) for warning in status["warnings"]),
        ("device", f"{status['device']}, fringed {status['version']}, up {status['uptime_s']:.0f} s"),
        ("calibration", status["calibration"]),
        *([] if status["mode"] == "single" else [("mode", mode_text(status["mode"], status["sequence"]))]),
        ("clouds", f"{status['clouds']}, {status['cloud_rate_hz']:.1f} per second"),
        ("points", f"{status['points']} ({100 * status['valid']:.0f} % of the pixels)"),
        ("latency", "  ".join(f"{name} {value:.0f} ms" for name, value in latency.items()) or "no cloud yet"),
        ("published", "  ".join(f"{name} {value:.0f} ms" for name, value in published.items()) or "no subscribers"),
        ("pairs", f"{status['pairs']}, {status['pair_rate_hz']:.1f} per second"),
    ]
    for side, camera in status["cameras"].items():
        outcomes = ", ".join(f"{name} {count}" for name, count in camera["fates"].items() if count)
        text = f"{camera['state']}, {camera['rate_hz']:.1f} frames per second, {camera['losses']} losses; {outcomes}"
        out.append((f"camera {side}", text))
        counted = [f"{name} {count}" for name, count in camera["driver"].items() if count]
        warm = [f"{camera['temperature_c']:.0f} °C"] if camera["temperature_c"] is not None else []
        out.append(("", f"driver: {', '.join(warm + counted) or 'no counts'}"))
    for name, drops in drop_rows(status):
        out.append((name, ", ".join(f"{reason} {count}" for reason, count in drops.items()) or "none"))
    check = status.get("selfcheck", {})
    if check.get("enabled"):
        shown = [f"{name} {one['value']:+.3f}" for name, one in check["observables"].items() if "value" in one]
        out.append(
            ("self-check", f"{check['verdict']}, {check['checked']} pairs; {', '.join(shown) or 'no observations yet'}")
        )
    health = status.get("health", {})
    if health.get("enabled"):
        out.append(("health", "; ".join([health["verdict"], *health["open"].values()])))
    out.extend(remote_rows(status.get("sinks", {}).get("remote", {})))
    out.append(("recorder", recorder_text(status["recorder"])))
    return out


def drop_rows(status: dict[str, Any]) -> list[tuple[str, dict[str, int]]]:
    """What was dropped in service, and apart from it while the daemon started, by reason."""
    starting: dict[str, int] = status.get("drops_starting", {})
    service = {reason: count - starting.get(reason, 0) for reason, count in status["drops"].items()}
    rows = [("dropped", {reason: count for reason, count in service.items() if count})]
    return [*rows, ("at start", starting)] if starting else rows


def mode_text(mode: str, sequence: dict[str, Any]) -> str:
    """Format a multi-frame mode in one line."""
    text = f"{mode}, {sequence['frames']} images a cloud, {sequence['sets']} sets, {sequence['sets_incomplete']} lost"
    return f"{text}; held by {', '.join(sequence['held'])}" if sequence["held"] else text


def recorder_text(recorder: dict[str, Any]) -> str:
    """Format the recorder's state in one line."""
    kept = [f"{recorder['before']['kept_s']:.1f} s kept before a start"] if "before" in recorder else []
    if "file" not in recorder:
        return ", ".join(["off", *kept])
    parts = [
        Path(recorder["file"]).name,
        f"{recorder['pairs']} pairs, {recorder['bytes'] / 1e6:.1f} MB in {recorder['parts']} file(s)",
        f"safe up to trigger {recorder['synced']['up_to_sequence']}",
    ]
    parts += [f"{recorder['queued']} queued"] if recorder["queued"] else []
    parts += [f"{count} {name.replace('_', ' ')}" for name, count in recorder["dropped"].items()]
    parts += [f"interrupted {recorder['interruptions']}x"] if "interruptions" in recorder else []
    return ", ".join([*parts, *kept])


def remote_rows(remote: dict[str, object]) -> list[tuple[str, str]]:
    """Rows about access from other machines; none without a gate."""
    if not remote:
        return []
    refused = remote.get("refused")
    reasons = ", ".join(f"{name} {count}" for name, count in refused.items()) if isinstance(refused, dict) else ""
    accepted = f"{remote.get('connections')} connections, {remote.get('accepted')} accepted, {remote.get('keys')} keys"
    return [("remote", f"{accepted}; refused: {reasons or 'none'}")]
