"""``fringed status``: what a running daemon is doing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys, remote_rows


def main(
    endpoint: Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")] = None,
    rig: Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Print it once (so it is where this is no terminal).")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status once, as JSON.")] = False,
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the answer.")] = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Show what a running daemon is doing: a live page on a terminal, Ctrl-C ends it."""
    from rich.console import Console

    from daemon.control.rpc.client import ControlClient

    console, keys = Console(), chosen_keys(key, server_key)
    with ControlClient(control_endpoint(endpoint, rig), timeout_s=timeout, keys=keys) as client:
        status = client.call("status")  # a daemon that is not there is told at once
        if as_json:
            typer.echo(json.dumps(status, indent=2))
        elif once or not console.is_terminal:
            typer.echo(table(status))
        else:
            from daemon.cli.control.status_page import watch

            watch(lambda: dict(client.call("status")), console)


def control_endpoint(endpoint: str | None, rig: Path | None) -> str:
    """The endpoint that was named, that of a rig file, or the default."""
    if endpoint is not None:
        return endpoint
    if rig is not None:
        from daemon.config import load_rig

        return load_rig(rig).control.endpoint
    from daemon.common.ipc_endpoints import found_control_endpoint as default

    return default()


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
        *(("warning", warning) for warning in status["warnings"]),
        ("device", f"{status['device']}, fringed {status['version']}, up {status['uptime_s']:.0f} s"),
        ("calibration", status["calibration"]),
        *([] if status["mode"] == "single" else [("mode", mode_text(status["mode"], status["sequence"]))]),
        ("clouds", f"{status['clouds']}, {status['cloud_rate_hz']:.1f} per second"),
        ("points", f"{status['points']} ({100 * status['valid']:.0f} % of the pixels)"),
        ("latency", "  ".join(f"{name} {value:.0f} ms" for name, value in latency.items()) or "no cloud yet"),
        ("published", "  ".join(f"{name} {value:.0f} ms" for name, value in published.items()) or "nobody reads"),
        ("pairs", f"{status['pairs']}, {status['pair_rate_hz']:.1f} per second"),
    ]
    for side, camera in status["cameras"].items():
        fates = ", ".join(f"{name} {count}" for name, count in camera["fates"].items() if count)
        text = f"{camera['state']}, {camera['rate_hz']:.1f} frames per second, {camera['losses']} losses; {fates}"
        out.append((f"camera {side}", text))
        counted = [f"{name} {count}" for name, count in camera["driver"].items() if count]
        warm = [f"{camera['temperature_c']:.0f} °C"] if camera["temperature_c"] is not None else []
        out.append(("", f"driver: {', '.join(warm + counted) or 'nothing to tell'}"))
    out.append(("dropped", ", ".join(f"{name} {count}" for name, count in status["drops"].items()) or "nothing"))
    check = status.get("selfcheck", {})
    if check.get("enabled"):
        shown = [f"{name} {one['value']:+.3f}" for name, one in check["observables"].items() if "value" in one]
        out.append(
            ("self-check", f"{check['verdict']}, {check['checked']} pairs; {', '.join(shown) or 'nothing seen yet'}")
        )
    health = status.get("health", {})
    if health.get("enabled"):
        out.append(("health", "; ".join([health["verdict"], *health["open"].values()])))
    out.extend(remote_rows(status.get("sinks", {}).get("remote", {})))
    out.append(("recorder", recorder_text(status["recorder"])))
    return out


def mode_text(mode: str, sequence: dict[str, Any]) -> str:
    """A multi-frame mode, in a line."""
    told = f"{mode}, {sequence['frames']} images a cloud, {sequence['sets']} sets, {sequence['sets_incomplete']} lost"
    return f"{told}; held by {', '.join(sequence['held'])}" if sequence["held"] else told


def recorder_text(recorder: dict[str, Any]) -> str:
    """What the recorder does, in a line."""
    kept = [f"{recorder['before']['kept_s']:.1f} s before now kept"] if "before" in recorder else []
    if "file" not in recorder:
        return ", ".join(["off", *kept])
    told = [
        Path(recorder["file"]).name,
        f"{recorder['pairs']} pairs, {recorder['bytes'] / 1e6:.1f} MB in {recorder['parts']} file(s)",
        f"safe up to trigger {recorder['synced']['up_to_sequence']}",
    ]
    told += [f"{recorder['queued']} waiting"] if recorder["queued"] else []
    told += [f"{count} {name.replace('_', ' ')}" for name, count in recorder["dropped"].items()]
    told += [f"interrupted {recorder['interruptions']}x"] if "interruptions" in recorder else []
    return ", ".join([*told, *kept])
