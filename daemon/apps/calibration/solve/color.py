"""The colour step: colours from images of a white board in uniform and striped light, for a calibrated geometry."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.solve.archive import StoredCalibration, store
from daemon.apps.calibration.solve.solve import CalibrationResult
from daemon.apps.calibration.views.view import Progress, Source
from daemon.rig.calibration_file import CalibrationFile, read_calibration
from daemon.rig.camera_serials import common_serials, serial_problem, serials_in
from pipeline.calibrate.color import ColorSolution, calibrate_color
from pipeline.common.errors import ImageError, PatternError
from pipeline.pattern.projected_frames import Uniform
from pipeline.pattern.sequence import FrameSequence
from pipeline.rig.calibration import Calibration, Cameras

MOST_PASSES = 4
"""Views that are averaged; each needs some hundred megabytes of memory."""


@dataclass(frozen=True, slots=True, eq=False)
class ColorResult:
    """A calibration with new colours that is not written yet.

    Args:
        file: the original calibration; calibration: with the new colours; solution: the colours.
        summary, advice: sentences.
    """

    file: CalibrationFile
    calibration: Calibration
    solution: ColorSolution
    summary: list[str]
    advice: list[str]

    def write(self, out: Path, *, force: bool = False) -> StoredCalibration:
        """Write the calibration and keep the previous file; KeptError if that file's colours are better."""
        before = self.file.mapping.get("quality")
        quality = dict(before) if isinstance(before, Mapping) else {}
        return store(out, self.calibration, quality=quality | {"color": plain(self.solution.quality)}, force=force)


def is_color(sequence: FrameSequence | None) -> bool:
    """Whether a sequence has single-channel frames at several levels."""
    if sequence is None:
        return False
    levels = {frame.color for frame in sequence.frames if isinstance(frame, Uniform) and frame.color.count(0) == 2}
    return len(levels) >= 6


def calibrate_colors(path: Path, sources: Sequence[Source], progress: Progress) -> ColorResult:
    """Calibrate the colours for the calibration in a file.

    Raises:
        CalibrationError: the file has no projector.
        SourceError, ImageError, PatternError: unusable images.
    """
    file = read_calibration(path)
    known = serials_in(file.mapping["cameras"])
    if problem := serial_problem(known, common_serials((source.name, source.serials) for source in sources)):
        raise SourceError(f"{', '.join(source.name for source in sources)}: {problem}")
    solution = solve_colors(sources, progress, file.calibration)
    return ColorResult(
        file, solution.applied(file.calibration), solution, summary(solution), list(solution.recommendations)
    )


def with_colors(result: CalibrationResult, sources: Sequence[Source], progress: Progress) -> CalibrationResult:
    """Add the colours to a calibration result."""
    solution = solve_colors(sources, progress, result.cameras.complete())
    cameras: Cameras = replace(
        result.cameras,
        left_color=solution.left,
        right_color=solution.right,
        response=solution.response,
        registration=solution.registration,
    )
    notes = [note for note in result.notes if not re.search("of the old file (are|is) kept", note)]
    notes += [*summary(solution), *solution.recommendations]
    return replace(result, cameras=cameras, quality=result.quality | {"color": plain(solution.quality)}, notes=notes)


def solve_colors(sources: Sequence[Source], progress: Progress, calibration: Calibration | None) -> ColorSolution:
    """Solve for the colours from all views of the sources, averaged: each view is a pass of the same sequence."""
    sequence = sources[0].sequence
    names = ", ".join(source.name for source in sources)
    if sequence is None or not is_color(sequence):
        raise SourceError(f"{names}: no sequence of uniform colours; capture with the sequence 'color'")
    pairs: list[tuple[Any, Any]] = []
    encoding = ""
    for source in sources:
        if source.sequence is None or source.sequence.as_mapping() != sequence.as_mapping():
            raise SourceError(
                f"{source.name}: its sequence differs from that of {sources[0].name}; all sources of colours need the "
                "same one"
            )
        for view in source.views(progress):
            if encoding and view.encoding != encoding:
                raise SourceError(f"{view.files[0]}: encoding {view.encoding}, but the first view has {encoding}")
            encoding = view.encoding
            if len(pairs) < MOST_PASSES * len(sequence):
                pairs += list(zip(view.left, view.right, strict=True))
    if not pairs:
        raise SourceError(f"{names}: no view has all frames of the sequence")
    try:
        return calibrate_color(pairs, sequence, encoding=encoding, calibration=calibration)
    except (ImageError, PatternError) as error:
        raise type(error)(f"{names}: {error}") from error


def summary(solution: ColorSolution) -> list[str]:
    """The results as sentences."""
    out = []
    for side, color in (("left", solution.left), ("right", solution.right)):
        off = color.crosstalk[~np.eye(3, dtype=bool)]
        black = ", ".join(f"{level:.1f}" for level in color.black)
        out.append(f"{side}: black {black} counts, crosstalk up to {100 * off.max():.1f} %")
        errors = solution.quality.get(side, {}).get("phase_error_rad")
        if errors is not None:
            out.append(f"{side}: phase error {errors[0]:.4f} rad uncorrected, {errors[1]:.4f} rad with the new colours")
    return out


def plain(value: Any) -> Any:
    """Convert numbers and arrays to plain YAML values of six digits."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.6g}")
    return int(value) if isinstance(value, np.integer) else value
