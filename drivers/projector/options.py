"""Options of the projector drivers, checked; errors name the key as in rig.yaml."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any, Literal, TypeVar

import msgspec

from drivers.errors import DriverError

SIZE_LIMIT = 8192
COMMANDS_LIMIT = 16


class HookOptions(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Commands for projectors that other programs set up.

    Args:
        open: run before the output is checked; show: after each image is displayed, also after a restart; close:
            after the window is closed. Each command is a list: program and arguments, never a shell line.
        timeout_s: longest time for each command.
    """

    open: tuple[tuple[str, ...], ...] = ()
    show: tuple[tuple[str, ...], ...] = ()
    close: tuple[tuple[str, ...], ...] = ()
    timeout_s: float = 10.0


class LatencyOptions(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Measured latency of the projector, from vertical blank to light, in one of two units."""

    latency_frames: float | None = None
    latency_ms: float | None = None

    def latency_s(self, refresh_hz: float) -> float | None:
        """Return the latency in seconds; None if it was never measured (or the refresh rate is unknown)."""
        if self.latency_ms is not None:
            return self.latency_ms / 1e3
        return self.latency_frames / refresh_hz if self.latency_frames is not None and refresh_hz > 0 else None


class ProjectorOptions(LatencyOptions, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A projector at an output of the graphics card.

    Args:
        output: RandR name such as ``HDMI-1``; ``fringed projector list`` prints them.
        display: X display such as ``:0``; empty = the environment's DISPLAY.
        mode: ``native`` requires the preferred mode of the projector; ``any`` does not.
        size: (width, height) that the output must have, pixels; None = any that passes ``mode``.
        refresh_hz: refresh rate that the output must have, within 0.03 Hz, which distinguishes 59.94 from 60.
        gamma: ``check`` refuses an output whose gamma table is not linear; ``reset`` makes it linear until close.
        show_timeout_s: longest wait for an image to be displayed before ``problem`` reports it.
    """

    output: str
    display: str = ""
    mode: Literal["native", "any"] = "native"
    size: tuple[int, int] | None = None
    refresh_hz: float | None = None
    gamma: Literal["check", "reset"] = "check"
    show_timeout_s: float = 3.0
    hook: HookOptions = HookOptions()

    def display_name(self) -> str:
        """Return the configured display, or the environment's; DriverError if there is none."""
        return named_display(self.display)


class ExternalOptions(LatencyOptions, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A projector that shows its image by itself: from its flash memory, or driven by another program.

    Args:
        size: (width, height) of its images, pixels; refresh_hz: its frame rate, 0 if unknown.
        name: for messages.
    """

    size: tuple[int, int]
    refresh_hz: float = 0.0
    name: str = "external"
    hook: HookOptions = HookOptions()


Options = TypeVar("Options", ProjectorOptions, ExternalOptions)


def read(kind: type[Options], options: Mapping[str, Any]) -> Options:
    """Check plain values; ValueError("projector.KEY: ...") names the invalid option."""
    try:
        parsed = msgspec.convert(dict(options), kind)
    except msgspec.ValidationError as error:
        raise ValueError(_with_key(str(error))) from None
    _check(parsed)
    return parsed


def named_display(display: str) -> str:
    """Return this display, or the environment's; DriverError if there is none."""
    name = display or os.environ.get("DISPLAY", "")
    if not name:
        raise DriverError("no X display: set projector.options.display, or DISPLAY, to one such as :0")
    return name


_FIELD = re.compile(r"Object (contains unknown|missing required) field `(.*)`")
_MESSAGES = {"contains unknown": "no such option", "missing required": "is missing"}


def _with_key(text: str) -> str:
    """Rewrite "Expected `str`, got `int` - at `$.output`" to "projector.output: expected `str`, got `int`"."""
    message, _, path = text.partition(" - at `$")
    key = path.rstrip("`")
    if field := _FIELD.fullmatch(message):
        key, message = f"{key}.{field[2]}", _MESSAGES[field[1]]
    return f"projector{key}: {message[:1].lower()}{message[1:]}"


def _check(options: ProjectorOptions | ExternalOptions) -> None:
    if options.size is not None and not all(1 <= side <= SIZE_LIMIT for side in options.size):
        raise ValueError(f"projector.size: {list(options.size)}, expected 1 to {SIZE_LIMIT} pixels each way")
    if options.refresh_hz is not None and not 0 <= options.refresh_hz <= 1000:
        raise ValueError(f"projector.refresh_hz: {options.refresh_hz}, expected 0 to 1000")
    if options.latency_frames is not None and options.latency_ms is not None:
        raise ValueError("projector.latency_ms: latency_frames is given too; keep one of them")
    for key in ("latency_frames", "latency_ms"):
        value = getattr(options, key)
        if value is not None and not 0 <= value <= 1000:
            raise ValueError(f"projector.{key}: {value}, expected 0 to 1000")
    if isinstance(options, ProjectorOptions):
        if not options.output.strip():
            raise ValueError("projector.output: empty, expected a RandR name such as HDMI-1")
        if not 0.1 <= options.show_timeout_s <= 60:
            raise ValueError(f"projector.show_timeout_s: {options.show_timeout_s}, expected 0.1 to 60")
    _check_hook(options.hook)


def _check_hook(hook: HookOptions) -> None:
    if not 0.1 <= hook.timeout_s <= 600:
        raise ValueError(f"projector.hook.timeout_s: {hook.timeout_s}, expected 0.1 to 600")
    for key in ("open", "show", "close"):
        commands: tuple[tuple[str, ...], ...] = getattr(hook, key)
        if len(commands) > COMMANDS_LIMIT:
            raise ValueError(f"projector.hook.{key}: {len(commands)} commands, expected at most {COMMANDS_LIMIT}")
        for number, command in enumerate(commands):
            if not command or not command[0] or any("\0" in part for part in command):
                raise ValueError(f"projector.hook.{key}[{number}]: expected a program and its arguments")
