"""The projector's output: the X server, the mode, the gamma table, and programs that interfere with the image."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.rig.display_process import Screen
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import run_program
from drivers.child_process import interpreter
from drivers.errors import DriverError
from drivers.projector.options import ProjectorOptions, named_display
from drivers.projector.x11.detected_output import (
    DetectedOutput,
    find_output,
    gamma_problem,
    mode_problem,
    output_problem,
)

area = Area("display")

INTERFERING = {
    "redshift": "colours the screen at night",
    "gammastep": "colours the screen at night",
    "xscreensaver": "covers the image without keyboard input",
    "light-locker": "covers the image without keyboard input",
    "xss-lock": "covers the image without keyboard input",
    "gnome-screensav": "covers the image without keyboard input",
}
"""Programs that interfere with the image, by short name, with their effect."""


def check(subject: Subject) -> Iterator[Finding]:
    """Check server, output and other programs."""
    certain = subject.uses("x11")
    options = subject.projector if isinstance(subject.projector, ProjectorOptions) else None
    try:
        outputs = subject.outputs
        name = named_display(options.display if options is not None else "")
    except DriverError as error:
        remedy = (
            "start an X server and set DISPLAY (or projector.options.display) to it, such as :0; "
            "see docs/how-to/projector.md"
        )
        if certain:
            yield area.problem("server", str(error), remedy)
        else:
            yield area.note("server", str(error), remedy)
        return
    active = ", ".join(describe(output) for output in outputs if output.is_on)
    yield area.ok("server", f"X display {name} answers; outputs: {active or 'none is active'}")
    if options is not None:
        yield from output_findings(outputs, options)
    yield from surroundings(subject, name)


def output_findings(outputs: list[DetectedOutput], options: ProjectorOptions) -> Iterator[Finding]:
    """Check whether the rig's output can show the pattern pixel by pixel."""
    missing = output_problem(outputs, options.output)
    output = find_output(outputs, options.output)
    if missing or output is None:
        yield area.problem("output", *_remedy(missing, "connect the projector; compare with: fringed devices"))
        return
    wrong = mode_problem(output, native=options.mode == "native", size=options.size, refresh_hz=options.refresh_hz)
    if wrong:
        yield area.problem("mode", *_remedy(wrong, "set that mode with xrandr, or correct projector.options"))
    else:
        fit = "its native resolution" if output.preferred_size == output.size else "as configured"
        yield area.ok("mode", f"{describe(output)}, {fit}")
    nonlinear = gamma_problem(output)
    if nonlinear and options.gamma == "check":
        yield area.problem("gamma", *_remedy(nonlinear, "set projector.options.gamma to reset"))
    elif nonlinear:
        yield area.note("gamma", f"the gamma table of {output.name} is not linear; it is linearised while measuring")
    else:
        linear = "the gamma table is linear" if output.gamma_identity else "the output has no gamma table"
        yield area.ok("gamma", linear)
    if not output.refresh_hz:
        remedy = "set projector.options.refresh_hz to the projector's"
        yield area.warning("refresh", "the refresh rate is unknown", remedy)
    for note in output.notes:
        yield area.note("output", note)


def surroundings(subject: Subject, name: str) -> Iterator[Finding]:
    """Check compositor, screen saver, power saving, Wayland and interfering programs."""
    certain = subject.uses("x11")
    screen = read_screen(name)
    if screen.problem:
        yield area.note("surroundings", f"unknown: {screen.problem}")
    if subject.machine.environ.get("XDG_SESSION_TYPE") == "wayland":
        text = "the session is Wayland: its compositor shows X programs, so the times of flips are unreliable"
        yield _graded("wayland", text, 'choose an "Xorg" session at login', certain)
    if screen.compositor:
        text = "a compositing manager runs, which may delay images by a frame"
        yield _graded(
            "compositor",
            text,
            "disable compositing in the desktop's settings, or use an X server without a desktop",
            certain,
        )
    if screen.blank_after_s or screen.dpms:
        causes = [f"the screen saver starts after {screen.blank_after_s} s"] if screen.blank_after_s else []
        causes += ["DPMS may switch monitors off"] if screen.dpms else []
        text = f"{' and '.join(causes)}; both are suspended while measuring"
        yield area.note("saver", text, f"DISPLAY={name} xset s off -dpms")
    for program in subject.machine.programs():
        if program.name in INTERFERING:
            text = f"{program} {INTERFERING[program.name]}"
            yield _graded("meddler", text, f"end it and remove it from the autostart: kill {program.pid}", certain)
    if not (screen.problem or screen.compositor or screen.blank_after_s or screen.dpms):
        yield area.ok("surroundings", "no compositor, no screen saver, no power saving")


def read_screen(name: str) -> Screen:
    """Read the display's settings in another process."""
    answer = run_program([*interpreter(), "-m", "daemon.apps.doctor.rig.display_process", name], 15.0)
    try:
        return msgspec.json.decode(answer.out, type=Screen)
    except msgspec.MsgspecError:
        return Screen(problem=answer.problem)


def describe(output: DetectedOutput) -> str:
    """Format an output with its mode."""
    rate = f"@{output.refresh_hz:.2f}" if output.refresh_hz else ""
    return f"{output.name} {output.size[0]}x{output.size[1]}{rate}"


def _remedy(text: str, otherwise: str) -> tuple[str, str]:
    """Split a driver's message into problem and remedy."""
    problem, _, todo = text.partition("; ")
    return (problem, todo) if todo.startswith(("run:", "set ")) else (text, otherwise)


def _graded(name: str, text: str, remedy: str, certain: bool) -> Finding:
    return area.warning(name, text, remedy) if certain else area.note(name, text, remedy)
