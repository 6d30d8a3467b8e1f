"""What the first pair with points sets once: the projector's column correction and the response of the right camera.

See :mod:`pipeline.reconstruct.column_correction` and :mod:`pipeline.reconstruct.camera_response` for the two models.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.decode.decoder import Decoder, PhaseMap
from pipeline.filter.texture_agreement import scale_of
from pipeline.fringe_order.margins.order_margins import CLEAR_GAIN
from pipeline.fringe_order.order_search import UNCALIBRATED, OrderSearch
from pipeline.geometry.view_tables import View
from pipeline.match.match_result import MatchResult
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct import camera_response, column_correction
from pipeline.reconstruct.column_correction import Correction, CorrectionState
from pipeline.reconstruct.consistency import LEAST_PIXELS, ColumnScan, relative_cost
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

F64 = NDArray[np.float64]

_RESPONSE_ROUNDS, _VIGNETTING_ROUNDS, _LEAST_POINTS, _BRIGHTNESS_STEP = 3, 2, 1000, 0.03
_STRIDE, _SCAN_STRIDE, _ACROSS_STRIDE, _CURRENT_STRIDE = 8, 16, 4, 32
"""Distance of the lattice rows whose costs are averaged, of the search, of the scan and of every later pair."""
_HALF_STEP = 0.125
"""Columns from an offset of the search to one between it and the next: costs fall to those of noise within 0.1 only."""
_LOW_GAIN, _LITTLE_TEXTURE = 0.3, 0.1
"""Gain in log likelihood below which costs with so small a share of the texture's weight are tried as well: unequal
brightness hides that right orders agree."""
_NO_GAIN, _COMPARED = 0.005, 0.75
"""Gain that is no evidence; columns from 0 within which other offsets are compared where few pixels agree."""
_FEW_AGREE, _AS_PROBABLE = 0.6, 0.5
"""Gain from which the offset is certain; share of its probability from which another one explains the pair as well."""
_DISPLACEMENTS_PX = (1, 2, 3, 5, 7, 10, 14, 20)


class Calibrating(Protocol):
    """The reconstructor, as far as its first pair uses and changes it."""

    calibration: Calibration
    pattern: ColorFringe
    volume: Volume
    settings: Settings
    left: View
    searches: tuple[OrderSearch, OrderSearch]
    decoders: list[Decoder]
    correction: Correction
    response: NDArray[np.float64]
    calibrated: bool
    other_shifts: NDArray[np.float64]
    repeats: bool
    gain: float
    scan: ColumnScan | None

    def decode(self, left: NDArray[Any], right: NDArray[Any], /) -> tuple[PhaseMap, PhaseMap]:
        """Phases of a pair of raw images, valid until the next call."""

    def match(self, left: PhaseMap, right: PhaseMap, /) -> MatchResult:
        """The match of every left pixel, valid until the next call."""

    def state(self) -> CorrectionState:
        """What :meth:`restore` takes."""

    def restore(self, kept: CorrectionState, /) -> None:
        """Set correction and response, without a prior."""

    def set_response(self, response: NDArray[np.float64], /) -> None:
        """Set the response (19,), see :mod:`.camera_response`."""

    def clear_prior(self) -> None:
        """Search the next pair in full."""


def has_points(made: Calibrating, left: PhaseMap, right: PhaseMap) -> bool:
    """Whether a pair has points enough to calibrate with: an empty scene would give any offset."""
    match = made.match(left, right)
    return len(column_correction.column_differences(made.left, match, made.correction)[0]) >= _LEAST_POINTS


def calibrate(
    made: Calibrating, left: NDArray[Any], right: NDArray[Any], maps: tuple[PhaseMap, PhaseMap]
) -> tuple[PhaseMap, PhaseMap]:
    """Measure column correction and response from a pair of raw images; returns its phases after that."""
    brightness = camera_response.brightness_of_images(*maps)
    if brightness != 1:
        maps = _with_response(made, camera_response.BRIGHTNESS, brightness, left, right)
    match = calibrate_columns(made, *maps)
    color, other = made.decoders[0].color(left), made.decoders[1].color(right)
    gains = camera_response.gains_of_images(color, other, maps[0].valid, maps[1].valid)
    if (gains != 1).any():
        maps = _with_gains(made, gains, left, right)
        match = calibrate_columns(made, *maps)
    for _ in range(_RESPONSE_ROUNDS):
        equal = (made.response[:3] == 1).all()
        least = camera_response.UNEQUAL if equal else camera_response.CORRECTED
        gains = camera_response.gains_of_points(color, made.decoders[1].color(right), match, least)
        if (gains == 1).all():
            break
        maps = _with_gains(made, gains, left, right)
        match = made.match(*maps)
    error = camera_response.periodic_error(maps[0], match)
    if error.any():
        maps = _with_response(made, camera_response.ERROR, error, left, right)
        match = calibrate_columns(made, *maps)
    brightness = camera_response.brightness_of_points(*maps, match)
    if abs(brightness / made.response[camera_response.BRIGHTNESS] - 1) > _BRIGHTNESS_STEP:
        maps = _with_response(made, camera_response.BRIGHTNESS, brightness, left, right)
        match = calibrate_columns(made, *maps)
    for _ in range(_VIGNETTING_ROUNDS):
        factor = camera_response.vignetting_of_points(
            *maps, match, float(made.response[camera_response.BRIGHTNESS]), repeats=made.repeats
        )
        if np.array_equal(factor, made.response[camera_response.VIGNETTING]):
            break
        maps = _with_response(made, camera_response.VIGNETTING, factor, left, right)
        match = calibrate_columns(made, *maps)
    if made.gain < _FEW_AGREE:
        maps, match = compared_with_others(made, left, right, maps)
    contrast = camera_response.contrast_of_points(*maps, match, made.left.first_axis)
    share = camera_response.texture_share(maps[0], maps[1].with_corrected_mean(), match)
    kept = _changed(made.response, camera_response.CONTRAST, contrast)
    made.set_response(_changed(kept, camera_response.TEXTURE, share))
    made.scan = scan_columns(made, *maps)
    return maps


def compared_with_others(
    made: Calibrating, left: NDArray[Any], right: NDArray[Any], maps: tuple[PhaseMap, PhaseMap]
) -> tuple[tuple[PhaseMap, PhaseMap], MatchResult]:
    """Phases and match at the offset that is the most probable with the brightness which its own matches have.

    Brightness is measured at matched points. Measured at those of a wrong offset, it makes this one more probable.
    """
    first = made.searches[0]
    offsets = column_correction.offsets_to_try(made.settings.self_calibration_range)
    costs = [first.least_costs(*maps, np.array([each, 0.0, 0.0]), stride=_STRIDE) for each in offsets]
    costs.append(first.least_costs(*maps, made.correction, stride=_STRIDE))
    states, places, shifts = [made.state()], [_in_the_middle(made)], made.other_shifts
    even = _changed(made.response, camera_response.VIGNETTING, camera_response.EQUAL[camera_response.VIGNETTING])
    for offset in offsets[np.abs(offsets) <= _COMPARED]:
        made.set_response(even)
        maps = made.decode(left, right)
        made.correction = np.array([offset, 0.0, 0.0])
        made.clear_prior()
        match = made.match(*maps)
        if len(_fit_correction(made, match)[0]) < _LEAST_POINTS:
            continue
        brightness = camera_response.brightness_of_points(*maps, match)
        factor = camera_response.vignetting_of_points(*maps, match, brightness, repeats=made.repeats)
        bright = _changed(even, camera_response.BRIGHTNESS, brightness)
        made.set_response(_changed(bright, camera_response.VIGNETTING, factor))
        costs.append(first.least_costs(*made.decode(left, right), made.correction, stride=_STRIDE))
        states.append(made.state())
        places.append(_in_the_middle(made))
    likelihood = column_correction.OffsetLikelihood.of(np.concatenate([offsets, places]), costs)
    gains, probable = (each[len(offsets) :] for each in (likelihood.gain, likelihood.probable))
    probable = np.where(gains < _NO_GAIN, 0.0, probable)
    best = int(np.argmax(probable))
    clearly = probable[best] > column_correction.CLEAR_RATIO * probable[0]
    chosen = best if clearly else 0
    made.restore(states[chosen])
    maps = made.decode(left, right)
    match = calibrate_columns(made, *maps, chosen=places[chosen]) if clearly else made.match(*maps)
    known = made.other_shifts if clearly else shifts
    as_probable = (gains > CLEAR_GAIN) & (probable > _AS_PROBABLE * probable[chosen])
    others = [n for n in np.argsort(-probable, kind="stable") if as_probable[n]]
    made.other_shifts = column_correction.with_others(known, [places[n] - places[chosen] for n in others])
    return maps, match


def _in_the_middle(made: Calibrating) -> float:
    """The correction in the middle of the projector's image, columns."""
    middle = (np.array(made.pattern.size) - 1.0) / 2
    return float(made.correction @ (1.0, middle[made.left.first_axis], middle[1 - made.left.first_axis]))


def scan_columns(made: Calibrating, left: PhaseMap, right: PhaseMap) -> ColumnScan | None:
    """Cost of the order search over column offsets, and over displacements of the right image; None without fringes.

    The offsets are half a period to both sides. The displacements, across the epipolar lines, are tried at the offset
    with the least cost that a drift of the projector explains.
    """
    search = made.searches[0]
    offsets = column_correction.offsets_to_try(made.pattern.length / made.pattern.periods / 2)
    costs = [search.least_costs(left, right, np.array([each, 0.0, 0.0]), stride=_SCAN_STRIDE) for each in offsets]
    largest = made.settings.self_calibration_range
    means = np.where(np.abs(offsets) <= largest, [mean_of(cost) for cost in costs], np.inf)
    allowed = np.array([offsets[means.argmin()], 0.0, 0.0])
    across = {
        pixels: mean_of(
            search.least_costs(left, right.displaced(pixels, made.left.first_axis), allowed, stride=_ACROSS_STRIDE)
        )
        for pixels in (0, *(sign * each for each in _DISPLACEMENTS_PX for sign in (1, -1)))
    }
    corrected = search.least_costs(left, right, made.correction, stride=_STRIDE)
    current = _current_quartile(made, left, right)
    made.clear_prior()
    return ColumnScan.of(offsets, costs, largest, across, corrected, _in_the_middle(made), current)


def current_cost(made: Calibrating, left: PhaseMap, right: PhaseMap, scan: ColumnScan) -> float | None:
    """Cost of a pair at the correction in use over that of unrelated phases of the scanned pair; None: no fringes."""
    quartile = _current_quartile(made, left, right)
    return relative_cost(quartile, scan.unrelated) if np.isfinite(quartile) else None


def _current_quartile(made: Calibrating, left: PhaseMap, right: PhaseMap) -> float:
    """Lower quartile of the pixels' costs at the correction in use; NaN without fringes."""
    costs = made.searches[0].least_costs(left, right, made.correction, stride=_CURRENT_STRIDE)
    return float(np.quantile(costs, 0.25)) if len(costs) >= LEAST_PIXELS else np.nan


def calibrate_columns(
    made: Calibrating, left: PhaseMap, right: PhaseMap, *, chosen: float | None = None
) -> MatchResult:
    """Find the projector's column correction from a pair and keep it; returns the match, valid until the next.

    Args:
        chosen: the offset where it is known, columns.
    """
    inside = OrderSearch(View.of(made.calibration, made.pattern, made.volume, made.settings), by_brightness=False)
    offsets = column_correction.offsets_to_try(made.settings.self_calibration_range)

    def costs(search: OrderSearch, offset: float, texture: float = UNCALIBRATED) -> NDArray[np.float32]:
        return search.least_costs(left, right, np.array([offset, 0.0, 0.0]), stride=_STRIDE, texture=texture)

    tried = np.concatenate([offsets, offsets[:-1] + _HALF_STEP])
    all_costs = [costs(made.searches[0], each) for each in tried]
    finer = column_correction.finer_offsets(tried, np.array([mean_of(each) for each in all_costs]), _HALF_STEP / 2)
    all_costs += [costs(made.searches[0], each) for each in finer]
    tried = np.concatenate([tried, finer])
    means = np.array([mean_of(each) for each in all_costs])
    with_margin = np.array([means[np.abs(tried - each) <= _HALF_STEP / 2].min() for each in offsets])
    values = column_correction.improbability(
        offsets, with_margin, np.array([mean_of(costs(inside, each)) for each in offsets])
    )
    likelihood = column_correction.OffsetLikelihood.of(tried, all_costs)
    texture = UNCALIBRATED
    if likelihood.gain.max() < _LOW_GAIN:
        less = [costs(made.searches[0], each, _LITTLE_TEXTURE) for each in tried]
        other = column_correction.OffsetLikelihood.of(tried, less)
        if other.gain.max() > likelihood.gain.max():
            texture, likelihood, all_costs = _LITTLE_TEXTURE, other, less
    if chosen is None:
        chosen = likelihood.clear_offset(_best_of_minima(made, left, right, offsets, values))
    made.correction = np.array([chosen, 0.0, 0.0])
    made.calibrated = True
    made.clear_prior()
    match = made.match(left, right)
    along, across = _fit_correction(made, match)
    middle = (np.median(along), np.median(across)) if len(along) else (0.0, 0.0)
    here = float(made.correction @ (1.0, *middle))
    corrected = made.searches[0].least_costs(left, right, made.correction, stride=_STRIDE)
    last = corrected
    if texture != UNCALIBRATED:
        last = made.searches[0].least_costs(left, right, made.correction, stride=_STRIDE, texture=texture)
    likelihood = column_correction.OffsetLikelihood.of(np.append(tried, here), [*all_costs, last])
    made.gain = likelihood.at(here)
    made.other_shifts = column_correction.other_shifts(offsets, with_margin, likelihood, here, mean_of(corrected))
    return match


def _fit_correction(made: Calibrating, match: MatchResult) -> tuple[F64, F64]:
    """Fit the correction to the matched points if they are enough; returns their projector coordinates, pixels."""
    difference, along, across = column_correction.column_differences(made.left, match, made.correction)
    if len(difference) >= _LEAST_POINTS:
        limit = made.settings.self_calibration_range + 1.0
        made.correction = column_correction.affine_fit(along, across, difference, limit=limit)
    return along, across


def mean_of(costs: NDArray[np.float32]) -> float:
    """Mean of the costs (n,) of pixels; 0 without any."""
    return float(costs.mean(dtype=np.float64)) if len(costs) else 0.0


def _best_of_minima(made: Calibrating, left: PhaseMap, right: PhaseMap, offsets: F64, values: F64) -> float:
    """The offset that costs and textures make the most probable one.

    The phases of a wall that is partly out of reach may agree better at a wrong offset than at the right one; the
    textures of the places that are matched then differ.
    """
    minima = column_correction.minima(offsets, values)
    if len(minima) == 1:
        return float(offsets[minima[0]])
    totals = []
    for n in minima:
        made.correction = np.array([offsets[n], 0.0, 0.0])
        difference = scale_of(made.match(left, right), left, right).mean_sigma
        made.clear_prior()
        totals.append(values[n] + column_correction.PER_TEXTURE * np.log(difference))
    return float(offsets[minima[int(np.argmin(totals))]])


def _with_gains(
    made: Calibrating, gains: NDArray[np.float64], left: NDArray[Any], right: NDArray[Any]
) -> tuple[PhaseMap, PhaseMap]:
    """Phases of a pair of raw images after the right camera's gains were multiplied."""
    return _with_response(made, slice(3), made.response[:3] * gains, left, right)


def _with_response(
    made: Calibrating, part: int | slice, values: Any, left: NDArray[Any], right: NDArray[Any]
) -> tuple[PhaseMap, PhaseMap]:
    """Phases of a pair of raw images after a part of the response was changed."""
    made.set_response(_changed(made.response, part, values))
    return made.decode(left, right)


def _changed(response: F64, part: int | slice, values: Any) -> F64:
    response = response.copy()
    response[part] = values
    return response
