"""Jobs of the compilation: names that a process can turn into the kernels of one part of the program."""

from __future__ import annotations

from collections.abc import Iterable

ENCODINGS = "rgb8", "bayer_rggb8"
"""One of each kind: the kernels of the other mosaics are the same."""
_ALL = "all"
MEASURE, MODE, RENDER, LATER = "measure", "mode", "render", "later"


def measuring_jobs(encoding: str, mode: str | None = None) -> tuple[str, ...]:
    """Jobs for images of an encoding; a multi-frame mode needs those of the single shot, too."""
    from pipeline.pattern.mode_sequences import MODES
    from pipeline.reconstruct import compilation

    # Mosaics share their kernels, and all encodings those behind the decoder.
    kind = ENCODINGS[1] if encoding.startswith("bayer_") else encoding
    decode, *others, short = compilation.parts(kind)
    names = f"{MEASURE}/{kind}/{decode}", *(f"{MEASURE}/{_ALL}/{part}" for part in (*others, "monitor", short))
    return (*names, f"{MODE}/{kind}/{mode}") if mode in MODES else names


def rendering_jobs(encodings: Iterable[str]) -> tuple[str, ...]:
    """Jobs for the simulated rig's images."""
    return tuple(f"{RENDER}/{encoding}/images" for encoding in encodings)


def later_jobs() -> tuple[str, ...]:
    """Jobs of what no start needs: the filters of the cloud and the calibration, when they are first asked for."""
    return tuple(f"{LATER}/{_ALL}/{part}" for part in ("cloud filters", "circles", "corners"))


def release_jobs() -> tuple[str, ...]:
    """Jobs of a release: every mode with every kind of image, calibration, filters, and the simulated rig."""
    from pipeline.pattern.mode_sequences import MODES

    kinds = [(encoding, mode) for encoding in ENCODINGS for mode in (None, *MODES)]
    kinds += [("mono16", mode) for mode in MODES if mode != "two_color"]
    jobs = [*rendering_jobs(ENCODINGS), *(job for kind in kinds for job in measuring_jobs(*kind)), *later_jobs()]
    return tuple(dict.fromkeys(jobs))


def run_job(name: str) -> None:
    """Compile (or load) the kernels of a job; ValueError for an unknown one."""
    kind, encoding, part = name.split("/")
    if kind == MEASURE and part == "monitor":
        from pipeline.monitor.observe import warm_up

        warm_up(parallel=True)
    elif kind == MEASURE:
        from pipeline.reconstruct import compilation

        compilation.parts(ENCODINGS[0] if encoding == _ALL else encoding)[part]()
    elif kind == MODE:
        _compile_mode(part, encoding)
    elif kind == RENDER:
        _render(encoding)
    elif kind == LATER:
        _compile_later(part)
    else:
        raise ValueError(f"job {name!r} is unknown, expected {MEASURE}/..., {MODE}/..., {RENDER}/... or {LATER}/...")


def _compile_mode(mode: str, encoding: str) -> None:
    from pipeline.multi_frame.set_reconstructor import SetReconstructor
    from pipeline.pattern.mode_sequences import mode_sequence
    from pipeline.reconstruct.compilation import small_rig

    calibration, pattern, volume = small_rig()
    sequence = mode_sequence(mode, calibration.projector.size, periods=pattern.periods)
    SetReconstructor(calibration, sequence, volume, encoding=encoding).warm_up()


def _compile_later(part: str) -> None:
    from pipeline.calibrate.targets.localise import corner_fit, ellipse_fit
    from pipeline.reconstruct.compilation import compile_cloud_filters

    {"cloud filters": compile_cloud_filters, "circles": ellipse_fit.warm_up, "corners": corner_fit.warm_up}[part]()


def _render(encoding: str) -> None:
    import numpy as np

    from sim.devices.live_world import LiveScene
    from sim.devices.options import from_mapping
    from sim.devices.projector import LiveProjector
    from sim.render.render_pair import render_pair
    from sim.rig.layout import RigLayout
    from sim.rig.optics import Optics
    from sim.scene.named_scenes import build

    layout = RigLayout().scaled(0.125)
    render_pair(layout, build("moving"), layout.pattern(), Optics(), encoding=encoding)
    # A live rig in front of a printed board.
    options = from_mapping({"scene": "board", "live": True, "layout": {"scale": 0.125}, "encoding": encoding})
    columns, rows = options.layout.projector_size
    LiveScene(options, LiveProjector(np.zeros((rows, columns, 3), np.uint8))).pair(0)
