"""``fringed projector``: find the projector's output, and show images on it for its setup, without a daemon."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.setup import latency

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from drivers.projector import DetectedOutput, ExternalProjector, OutputProjector
    from drivers.protocols import Flip

app = typer.Typer(add_completion=False, no_args_is_help=True, rich_markup_mode=None)

RIG_LIMIT = 1 << 20
PNG_LIMIT = 1 << 28

Display = Annotated[str, typer.Option(help="X display such as :0.", show_default="DISPLAY")]
Output = Annotated[str | None, typer.Option(help="RandR output such as HDMI-1; see: fringed projector list.")]
Rig = Annotated[Path | None, typer.Option(help="Take the options from the projector section of this rig.yaml.")]
AnyMode = Annotated[bool, typer.Option("--any-mode", help="Accept a mode that is not the projector's native one.")]
ResetGamma = Annotated[bool, typer.Option("--reset-gamma", help="Use a linear gamma table meanwhile.")]
Seconds = Annotated[float | None, typer.Option(min=0.1, help="Stop after this time.", show_default="Ctrl-C")]


@app.callback()
def _root() -> None:
    """Find the projector's output, and show images on it for its setup."""


@app.command("list")
def list_outputs(
    display: Display = "",
    everything: Annotated[bool, typer.Option("--all", help="Also outputs without a connected device.")] = False,
) -> None:
    """Print the outputs of an X display, and obstacles to exact pixels."""
    from drivers.projector import outputs

    listed = [output for output in outputs(display) if everything or output.connected]
    for output in listed:
        typer.echo(describe(output))
    if not listed:
        typer.echo("no output has a connected device")


@app.command("test")
def test(
    output: Output = None,
    display: Display = "",
    rig: Rig = None,
    any_mode: AnyMode = False,
    reset_gamma: ResetGamma = False,
    seconds: Seconds = None,
) -> None:
    """Show the alignment image: frame, 1-pixel checkerboard, grey ramps, colours, cross hairs."""
    from drivers.projector.images import alignment

    show_image(_projector(output, display, rig, any_mode, reset_gamma), alignment, seconds)


@app.command("show")
def show(
    image: Annotated[str, typer.Argument(metavar="FILE.png|white|black|cross", help="Image of the output's size.")],
    output: Output = None,
    display: Display = "",
    rig: Rig = None,
    any_mode: AnyMode = False,
    reset_gamma: ResetGamma = False,
    seconds: Seconds = None,
) -> None:
    """Show an image until Ctrl-C."""
    from drivers.projector import images

    generators: dict[str, Callable[[tuple[int, int]], Any]] = {
        "white": lambda size: images.plain(size, 255),
        "black": lambda size: images.plain(size, 0),
        "cross": images.cross,
    }
    make = generators.get(image)
    if make is None:
        pixels = read_png(Path(image))
        make = lambda _: pixels  # noqa: E731
    show_image(_projector(output, display, rig, any_mode, reset_gamma), make, seconds)


@app.command("off")
def off(
    output: Output = None,
    display: Display = "",
    rig: Rig = None,
    any_mode: AnyMode = False,
    reset_gamma: ResetGamma = False,
) -> None:
    """Show black once, and run the projector's open and close commands of rig.yaml."""
    projector = _projector(output, display, rig, any_mode, reset_gamma)
    projector.open()
    before = projector.notes
    projector.close()
    for note in projector.notes[len(before) :]:
        typer.echo(note, err=True)


@app.command("white")
def white(output: Output = None, display: Display = "", rig: Rig = None, seconds: Seconds = None) -> None:
    """Show white until Ctrl-C: focus, brightness, flicker."""
    show("white", output, display, rig, seconds=seconds)


@app.command("cross")
def cross(output: Output = None, display: Display = "", rig: Rig = None, seconds: Seconds = None) -> None:
    """Show cross hairs until Ctrl-C: the direction of the projector's axis."""
    show("cross", output, display, rig, seconds=seconds)


app.command("latency")(latency.main)


def show_image(
    projector: OutputProjector | ExternalProjector,
    make: Callable[[tuple[int, int]], NDArray[np.uint8]],
    seconds: float | None,
) -> None:
    """Show the image that ``make`` returns for the projector's size; print problems until the end."""
    info = projector.open()
    try:
        with suppress(KeyboardInterrupt):
            typer.echo(f"{info.output}: {info.size[0]}x{info.size[1]} pixels at {info.refresh_hz:.3f} Hz")
            for note in projector.notes:
                typer.echo(f"note: {note}")
            flip = projector.show(make(info.size))
            typer.echo(f"shown{_confirmation(flip)}; {'Ctrl-C ends' if seconds is None else f'for {seconds:g} s'}")
            _watch(projector, None if seconds is None else time.monotonic() + seconds)
    finally:
        projector.close()


def _watch(projector: OutputProjector | ExternalProjector, deadline: float | None) -> None:
    printed = ""
    while deadline is None or time.monotonic() < deadline:
        problem = projector.problem()
        if problem != printed:
            typer.echo(problem or "the image is shown again", err=bool(problem))
            printed = problem
        time.sleep(0.2 if deadline is None else min(0.2, max(0.0, deadline - time.monotonic())))


def _confirmation(flip: Flip | None) -> str:
    if flip is None:
        return ""
    return {
        "present": "; the server confirms the flip",
        "vblank": "; drawn before a vertical blank",
        "unverified": "; the server reports no flip times",
    }[flip.source]


def describe(output: DetectedOutput) -> str:
    """Format an output as one line."""
    if not output.connected:
        return f"{output.name}: no connected device"
    if not output.is_on:
        return f"{output.name}: {output.edid_name or 'connected'}, switched off"
    parts = [
        f"{output.size[0]}x{output.size[1]} at +{output.position[0]}+{output.position[1]}",
        f"{output.refresh_hz:.3f} Hz" if output.refresh_hz else "refresh unknown",
        f"native {output.preferred_size[0]}x{output.preferred_size[1]}" if output.preferred_size else "native unknown",
        {True: "gamma linear", False: "gamma NOT linear", None: "gamma unknown"}[output.gamma_identity],
    ]
    parts += ["primary"] if output.primary else []
    parts += [f"rotated {output.rotation}"] if output.rotation != "normal" else []
    parts += ["scaled"] if output.scaled else []
    parts += output.notes
    return f"{output.name}: {f'{output.edid_name}, ' if output.edid_name else ''}{', '.join(parts)}"


def read_png(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit grey or colour PNG as (H, W, 3) red, green, blue; InputError for other files."""
    import cv2
    import numpy as np

    from daemon.common.errors import InputError
    from daemon.common.files import read_at_most

    data = read_at_most(path, PNG_LIMIT, InputError)
    # Lossy formats are rejected, because they change pixels.
    is_png = data.startswith(b"\x89PNG\r\n\x1a\n")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if is_png else None
    if image is None:
        raise InputError(f"{path}: not a readable image; expected an 8-bit PNG")
    if image.dtype != np.uint8 or (image.ndim == 3 and image.shape[2] != 3):
        raise InputError(f"{path}: {image.dtype} {image.shape}; expected 8 bits, grey or red-green-blue, no alpha")
    return np.ascontiguousarray(np.repeat(image[..., None], 3, 2) if image.ndim == 2 else image[..., ::-1])


def _projector(
    output: str | None, display: str, rig: Path | None, any_mode: bool, reset_gamma: bool
) -> OutputProjector | ExternalProjector:
    """Open the projector of the command line, or of a rig file with the command line's changes."""
    from daemon.common.errors import InputError
    from drivers.projector import open_external, open_projector

    driver, options = _section(rig) if rig is not None else ("", {})
    changes = {"output": output, "display": display or None, "mode": "any" if any_mode else None}
    changes["gamma"] = "reset" if reset_gamma else None
    options = {**options, **{key: value for key, value in changes.items() if value is not None}}
    base_dir = rig.resolve().parent if rig is not None else Path.cwd()
    try:
        if driver == "external" and output is None:
            return open_external(options, base_dir)
        if "output" not in options:
            raise typer.BadParameter("give --output or --rig; see: fringed projector list")
        return open_projector(options, base_dir)
    except ValueError as error:
        raise InputError(f"{rig}: {error}" if rig is not None else str(error)) from None


def _section(rig: Path) -> tuple[str, dict[str, Any]]:
    """Driver and options of the projector section; the rest of the file is not checked."""
    from daemon.common.errors import ConfigError, InputError
    from daemon.common.files import read_at_most
    from daemon.config.yaml_source import read_yaml

    source = read_yaml(read_at_most(rig, RIG_LIMIT, InputError).decode("utf-8", errors="replace"))
    if source.problems:
        raise ConfigError([f"{rig}:{p.line}:{p.column}: {p.message}" for p in source.problems])
    section = source.data.get("projector") if isinstance(source.data, dict) else None
    if not isinstance(section, dict) or not isinstance(section.get("options", {}), dict):
        raise InputError(f"{rig}: no section projector with driver and options")
    if section.get("driver") == "sim":
        raise InputError(f"{rig}: projector.driver is sim, which cannot show images")
    return str(section.get("driver")), dict(section.get("options", {}))
