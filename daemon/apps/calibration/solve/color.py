"""The colour step: images of a white board under even and striped light, into a calibration that has its geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.solve.archive import Stored, store
from daemon.apps.calibration.solve.solve import Calibrated
from daemon.apps.calibration.solve.solve import with_colors as _with_colors
from daemon.apps.calibration.views.view import Progress, Source
from daemon.rig.calibration_file import CalibrationFile, read_calibration
from pipeline.calibrate.color import ColorSolution, calibrate_color
from pipeline.common.errors import ImageError, PatternError
from pipeline.pattern.sequence import FrameSequence, Uniform
from pipeline.rig.calibration import Calibration, Cameras

MOST_PASSES = 4
"""Views that are averaged; each takes some hundred megabytes while it is worked on."""


@dataclass(frozen=True, slots=True, eq=False)
class Colored:
    """A calibration with new colours that is not written yet.

    Args:
        file: the calibration before; calibration: with the colours; solution: of the colours.
        summary, advice: sentences.
    """

    file: CalibrationFile
    calibration: Calibration
    solution: ColorSolution
    summary: list[str]
    advice: list[str]

    def write(self, out: Path, *, force: bool = False) -> Stored:
        """Write it; the one before stays beside it. KeptError if the colours that stand there are better."""
        before = self.file.mapping.get("quality")
        quality = dict(before) if isinstance(before, Mapping) else {}
        return store(out, self.calibration, quality=quality | {"color": plain(self.solution.quality)}, force=force)


def is_color(sequence: FrameSequence | None) -> bool:
    """Whether a sequence shows the channels one by one at several levels."""
    if sequence is None:
        return False
    single = {frame.color for frame in sequence.frames if isinstance(frame, Uniform) and frame.color.count(0) == 2}
    return len(single) >= 6


def colored(path: Path, sources: Sequence[Source], progress: Progress) -> Colored:
    """Colours for the calibration in a file.

    Raises:
        CalibrationError: the file has no projector yet.
        SourceError, ImageError, PatternError: what is wrong with the images.
    """
    file = read_calibration(path)
    solution = solved(sources, progress, file.calibration)
    return Colored(
        file, solution.applied(file.calibration), solution, summary(solution), list(solution.recommendations)
    )


def with_colors(result: Calibrated, sources: Sequence[Source], progress: Progress) -> Calibrated:
    """A rig that was just calibrated, with its colours."""
    solution = solved(sources, progress, result.cameras.complete())
    cameras: Cameras = replace(
        result.cameras,
        left_color=solution.left,
        right_color=solution.right,
        response=solution.response,
        registration=solution.registration,
    )
    notes = [
        note for note in result.notes if "of the old file stay" not in note and "in the old file stays" not in note
    ]
    result = replace(result, notes=notes)
    return _with_colors(
        result, cameras, {"color": plain(solution.quality)}, summary(solution) + list(solution.recommendations)
    )


def solved(sources: Sequence[Source], progress: Progress, calibration: Calibration | None) -> ColorSolution:
    """Colours from all views of the sources; the views are passes of one sequence and are averaged."""
    sequence = sources[0].sequence
    names = ", ".join(source.name for source in sources)
    if sequence is None or not is_color(sequence):
        raise SourceError(f"{names}: no sequence of even colours; capture with the sequence 'color'")
    pairs: list[tuple[Any, Any]] = []
    encoding = ""
    for source in sources:
        if source.sequence is None or source.sequence.as_mapping() != sequence.as_mapping():
            raise SourceError(f"{source.name}: another sequence than {sources[0].name}; colours need one and the same")
        for view in source.views(progress):
            if encoding and view.encoding != encoding:
                raise SourceError(f"{view.files[0]}: {view.encoding}, the images before are {encoding}")
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
    """What was found, in sentences."""
    out = []
    for side, color in (("left", solution.left), ("right", solution.right)):
        off = color.crosstalk[~np.eye(3, dtype=bool)]
        black = ", ".join(f"{level:.1f}" for level in color.black)
        out.append(f"{side}: black {black} counts, crosstalk up to {100 * off.max():.1f} %")
        errors = solution.quality.get(side, {}).get("phase_error_rad")
        if errors is not None:
            out.append(f"{side}: phase error {errors[0]:.4f} rad uncorrected, {errors[1]:.4f} rad with these colours")
    return out


def plain(value: Any) -> Any:
    """Numbers and lists of numbers as YAML knows them, to six digits."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.6g}")
    return int(value) if isinstance(value, np.integer) else value
