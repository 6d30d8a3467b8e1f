"""RandR outputs, and whether a pattern can be shown on one pixel by pixel."""

from __future__ import annotations

import msgspec

REFRESH_TOLERANCE_HZ = 0.03


class DetectedOutput(msgspec.Struct, frozen=True, kw_only=True):
    """One RandR output.

    Args:
        name: such as ``HDMI-1``; connected: whether a device is plugged in; primary: the desktop's main output.
        size, position: its rectangle on the X screen, pixels; (0, 0) where it is switched off.
        refresh_hz: of its mode, from the pixel clock and the totals: 59.94 is not 60. 0 = unknown.
        mode: name of its mode; mode_size: pixels of the mode itself, before scaling and rotation.
        preferred_size: the first preferred mode of the projector, None if there is none.
        edid_name: name in the EDID, empty if none.
        gamma_identity: whether the gamma table is linear; None if the output has none.
        rotation: ``normal``, ``left``, ``inverted``, ``right``, with ``, reflected`` where mirrored.
        scaled: whether the graphics card scales or transforms the image.
        notes: settings of the output that may change pixel values, each in a sentence.
    """

    name: str
    connected: bool
    primary: bool = False
    size: tuple[int, int] = (0, 0)
    position: tuple[int, int] = (0, 0)
    refresh_hz: float = 0.0
    mode: str = ""
    mode_size: tuple[int, int] = (0, 0)
    preferred_size: tuple[int, int] | None = None
    edid_name: str = ""
    gamma_identity: bool | None = None
    rotation: str = "normal"
    scaled: bool = False
    notes: tuple[str, ...] = ()

    @property
    def is_on(self) -> bool:
        """Whether it is connected and switched on."""
        return self.connected and self.size != (0, 0)


def find_output(outputs: list[DetectedOutput], name: str) -> DetectedOutput | None:
    """Return the output of that name."""
    return next((output for output in outputs if output.name == name), None)


def output_problem(outputs: list[DetectedOutput], name: str) -> str:
    """Return why the output cannot be used at all, and the usable ones; empty if it can."""
    output = find_output(outputs, name)
    if output is not None and output.is_on:
        return ""
    usable = ", ".join(other.name for other in outputs if other.is_on) or "none"
    if output is None:
        return f"output {name}: no such output on this display; there are: {usable}"
    if not output.connected:
        return f"output {name} is not connected; connected and switched on: {usable}"
    return f"output {name} is connected but switched off; run: xrandr --output {name} --auto"


def mode_problem(
    output: DetectedOutput,
    *,
    native: bool,
    size: tuple[int, int] | None,
    refresh_hz: float | None,
) -> str:
    """Return why images would not be displayed pixel by pixel; empty if they are.

    Args:
        output: switched on.
        native: whether its mode must be the preferred one of the projector.
        size: required size; refresh_hz: required rate; None = any.
    """
    name = f"output {output.name}"
    if output.rotation != "normal":
        return f"{name} is rotated ({output.rotation}); run: xrandr --output {output.name} --rotate normal"
    if output.scaled:
        return f"{name} is scaled by the graphics card; run: xrandr --output {output.name} --scale 1x1 --transform none"
    if size is not None and output.size != size:
        return f"{name} is {_pixels(output.size)}, expected {_pixels(size)} (projector.options.size)"
    if native and output.preferred_size is not None and output.size != output.preferred_size:
        wanted = _pixels(output.preferred_size)
        return (
            f"{name} is {_pixels(output.size)} but the projector's own resolution is {wanted}; "
            f"run: xrandr --output {output.name} --mode {wanted}, or set projector.options.mode to any"
        )
    if refresh_hz is not None and abs(output.refresh_hz - refresh_hz) > REFRESH_TOLERANCE_HZ:
        return f"{name} refreshes at {output.refresh_hz:.3f} Hz, expected {refresh_hz:g} Hz (projector.refresh_hz)"
    return ""


def gamma_problem(output: DetectedOutput) -> str:
    """Return why the gamma table changes the grey values; empty if it is linear or there is none."""
    if output.gamma_identity is not False:
        return ""
    return (
        f"output {output.name} has a gamma table that is not linear, so fringes would not be sinusoidal; "
        f"set projector.options.gamma to reset, or run: xrandr --output {output.name} --gamma 1 --brightness 1, "
        "and stop programs that colour the screen at night"
    )


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
