"""The projector's output: an X server that answers, the right mode, a linear gamma table, and nothing that meddles."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import msgspec

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.rig.display_process import Screen
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import ask
from drivers.errors import DriverError
from drivers.projector.found import OutputFound, absent, bent, find, unfit
from drivers.projector.options import named_display

area = Area("display")

MEDDLERS = {
    "redshift": "colours the screen at night",
    "gammastep": "colours the screen at night",
    "xscreensaver": "covers the image when nobody types",
    "light-locker": "covers the image when nobody types",
    "xss-lock": "covers the image when nobody types",
    "gnome-screensav": "covers the image when nobody types",
}
"""Programs that spoil the image, by their short names; what they do."""


def check(subject: Subject) -> Iterator[Finding]:
    """Server, output, surroundings."""
    certain = subject.uses("x11")
    try:
        outputs = subject.outputs
        name = named_display(subject.projector.display if certain and subject.projector is not None else "")
    except DriverError as error:
        remedy = (
            "start an X server and set DISPLAY (or projector.options.display) to it, such as :0; see docs/projector.md"
        )
        if certain:
            yield area.problem("server", str(error), remedy)
        else:
            yield area.note("server", str(error), remedy)
        return
    lit = [output for output in outputs if output.lit]
    yield area.ok("server", f"X display {name} answers; outputs: {', '.join(map(shown, lit)) or 'none is switched on'}")
    if certain and subject.projector is not None:
        yield from output_findings(outputs, subject.projector)
    yield from surroundings(subject, name)


def output_findings(outputs: list[OutputFound], options: object) -> Iterator[Finding]:
    """Whether the rig's output can show the pattern pixel by pixel."""
    wanted = str(getattr(options, "output", ""))
    missing = absent(outputs, wanted)
    output = find(outputs, wanted)
    if missing or output is None:
        yield area.problem("output", *_remedy(missing, "plug the projector in; compare with: fringed devices"))
        return
    native = getattr(options, "mode", "native") == "native"
    wrong = unfit(
        output, native=native, size=getattr(options, "size", None), refresh_hz=getattr(options, "refresh_hz", None)
    )
    if wrong:
        yield area.problem("mode", *_remedy(wrong, "choose that mode with xrandr, or correct projector.options"))
    else:
        yield area.ok(
            "mode", f"{shown(output)}, {'its own resolution' if output.preferred_size == output.size else 'as asked'}"
        )
    curved = bent(output)
    if curved and getattr(options, "gamma", "check") == "check":
        yield area.problem("gamma", *_remedy(curved, "set projector.options.gamma to reset"))
    elif curved:
        yield area.note("gamma", f"the gamma table of {output.name} is not linear; it is made so while measuring")
    else:
        yield area.ok(
            "gamma", "the gamma table is linear" if output.gamma_identity else "the output has no gamma table"
        )
    if not output.refresh_hz:
        yield area.warning(
            "refresh", "the refresh rate is unknown", "set projector.options.refresh_hz to the projector's"
        )
    for note in output.notes:
        yield area.note("output", note)


def surroundings(subject: Subject, name: str) -> Iterator[Finding]:
    """Compositor, screen saver, power saving, Wayland, programs that meddle."""
    certain = subject.uses("x11")
    screen = look(name)
    if screen.problem:
        yield area.note("surroundings", f"cannot be told: {screen.problem}")
    if subject.machine.environ.get("XDG_SESSION_TYPE") == "wayland":
        text = "the session is Wayland: X programs reach the screen through its compositor, flips cannot be trusted"
        yield _judged("wayland", text, 'choose an "Xorg" session at login', certain)
    if screen.compositor:
        text = "a compositing manager runs: it may show images a frame late"
        yield _judged(
            "compositor", text, "switch compositing off in the desktop's settings, or use a bare X server", certain
        )
    if screen.blank_after_s or screen.dpms:
        ways = [f"the screen saver comes after {screen.blank_after_s} s"] if screen.blank_after_s else []
        ways += ["DPMS may switch monitors off"] if screen.dpms else []
        yield area.note(
            "saver", f"{' and '.join(ways)}; both are held off while measuring", f"DISPLAY={name} xset s off -dpms"
        )
    for program in subject.machine.programs():
        if program.name in MEDDLERS:
            text = f"{program} {MEDDLERS[program.name]}"
            yield _judged("meddler", text, f"end it and take it out of the autostart: kill {program.pid}", certain)
    if not (screen.problem or screen.compositor or screen.blank_after_s or screen.dpms):
        yield area.ok("surroundings", "no compositor, no screen saver, no power saving")


def look(name: str) -> Screen:
    """The display's settings, read by another process."""
    answer = ask([sys.executable, "-m", "daemon.apps.doctor.rig.display_process", name], 15.0)
    try:
        return msgspec.json.decode(answer.out, type=Screen)
    except msgspec.MsgspecError:
        return Screen(problem=answer.why)


def shown(output: OutputFound) -> str:
    """An output in a few words."""
    rate = f"@{output.refresh_hz:.2f}" if output.refresh_hz else ""
    return f"{output.name} {output.size[0]}x{output.size[1]}{rate}"


def _remedy(text: str, otherwise: str) -> tuple[str, str]:
    """A driver's message, split into what is and what to do."""
    what, _, todo = text.partition("; ")
    return (what, todo) if todo.startswith(("run:", "set ")) else (text, otherwise)


def _judged(name: str, text: str, remedy: str, certain: bool) -> Finding:
    return area.warning(name, text, remedy) if certain else area.note(name, text, remedy)
