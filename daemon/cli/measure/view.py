"""``fringed view``: the stream of a daemon in the Rerun viewer, as a subscriber in its own process."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from daemon.apps.viewer.colors import COLORS
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys
from daemon.common.errors import InputError
from fringed.keys import Keys
from fringed.stream.subscription import DEFAULT_ENDPOINT


def main(
    endpoint: Annotated[str, typer.Argument(help="Of the stream: tcp://HOST:PORT or ipc://PATH.")] = DEFAULT_ENDPOINT,
    web: Annotated[bool, typer.Option("--web", help="Serve the viewer to a browser; prints its address.")] = False,
    save: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="Write a file for the viewer.")] = None,
    screenshot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Save an image of the web viewer, without a display.")
    ] = None,
    color: Annotated[str, typer.Option(help="Of the points: depth, texture, sigma or rgb.")] = "depth",
    decimate: Annotated[int, typer.Option(min=1, max=64, help="Stride of the shown rows and columns.")] = 2,
    rate: Annotated[float, typer.Option(min=0.1, max=60, help="Most clouds shown per second.")] = 15.0,
    count: Annotated[int | None, typer.Option(min=1, help="Stop after this number of clouds.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Stop after this time.")] = None,
    web_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Of the page; 0 = any free one.", show_default="9090")
    ] = None,
    grpc_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Of the data; 0 = any free one.", show_default="9876")
    ] = None,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Show the stream of a daemon in the Rerun viewer: native, in a browser (--web), or as a file (--save)."""
    if color not in COLORS:
        raise typer.BadParameter(f"{color!r} is not one of {', '.join(COLORS)}", param_hint="--color")
    if sum((web, save is not None, screenshot is not None)) > 1:
        raise typer.BadParameter("choose one of --web, --save and --screenshot")
    if not (web or save or screenshot or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "there is no screen (DISPLAY and WAYLAND_DISPLAY are not set); use --web for a browser, or --save FILE.rrd"
        )
    if screenshot is not None:
        from daemon.apps.viewer.screenshot import save_screenshot

        save_screenshot(endpoint, screenshot, color=color, decimate=decimate)
        typer.echo(f"wrote {screenshot}")
        return
    options = {"decimate": decimate, "color": color, "rate_hz": rate, "count": count, "seconds": seconds}
    keys = chosen_keys(key, server_key)
    _watch(endpoint, options, web=web, save=save, ports=(web_port, grpc_port), keys=keys)


def _watch(
    endpoint: str,
    options: dict[str, Any],
    *,
    web: bool,
    save: Path | None,
    ports: tuple[int | None, int | None],
    keys: Keys | None,
) -> None:
    from daemon.apps.viewer import rerun_targets
    from daemon.apps.viewer.bridge import Bridge, Options
    from daemon.apps.viewer.stream_source import COLOR_TOPIC, TOPICS, NewestMessages

    with ExitStack() as stack:
        topics = (COLOR_TOPIC, *TOPICS[1:]) if options["color"] == "rgb" else TOPICS
        source = stack.enter_context(NewestMessages(endpoint, topics, keys=keys))
        stopped: Callable[[], bool] = lambda: False  # noqa: E731
        if save is not None:
            stopped = _on_signals(stack)
            recording = stack.enter_context(rerun_targets.file_recording(save))
        elif web:
            recording, address = stack.enter_context(rerun_targets.web_recording(web_port=ports[0], grpc_port=ports[1]))
            typer.echo(address)
        else:
            recording, viewer = stack.enter_context(rerun_targets.native_recording())
            stopped = lambda: viewer.poll() is not None  # noqa: E731
            stack.callback(rerun_targets.check_viewer, viewer)
        if save is None:
            # A viewer that hangs blocks the logging call; Ctrl-C must end the process even then.
            _restore_signals(stack)
        bridge = Bridge(source, recording, Options(**options))
        bridge.run(stopped)
    _report(bridge.clouds, source, save)


def _report(clouds: int, source: Any, save: Path | None) -> None:
    shown = f"{save}: {clouds} clouds" if save is not None else f"{clouds} clouds shown"
    typer.echo(f"{shown}, {source.skipped} skipped, {source.lost} lost", err=True)
    if not clouds:
        raise InputError(f"no cloud arrived from {source.endpoint}; check with `fringed status` that a daemon runs")


def _on_signals(stack: ExitStack) -> Callable[[], bool]:
    """Stop on SIGINT and SIGTERM after the file is finished."""
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        stack.callback(signal.signal, number, signal.signal(number, lambda number, _: received.append(number)))
    return lambda: bool(received)


def _restore_signals(stack: ExitStack) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        stack.callback(signal.signal, number, signal.signal(number, signal.SIG_DFL))
