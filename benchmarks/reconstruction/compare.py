"""Time and error of other programs on the same pair of images."""

from __future__ import annotations

import json
import statistics
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.tables import Table
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import CASES, Case
from benchmarks.reconstruction.rendered import StoredPair
from benchmarks.reconstruction.speed import THREADS, cells, measure, timed
from benchmarks.reconstruction.worker import environment
from sim.evaluate.score import score
from sim.render.ground_truth import Truth, phases

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".bench-venv" / "bin" / "python"
RATIO = 25.0
"""Promised: `fringes`, decoding and unwrapping both images, takes at least this many times our whole pair."""

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class PhaseError:
    """Error of a phase map where the truth can be measured.

    Args:
        rms_rad: of the wrapped phase, a constant removed; order: share with the right period, one constant removed.
    """

    rms_rad: float
    order: float


def phase_error(absolute: Array, truth: Truth, case: Case) -> PhaseError:
    """Error of an unwrapped phase (H, W), up to its sign and one constant; NaN = unknown."""
    where = truth.scorable
    true = phases(truth.projector[where].astype(np.float64), case.pattern)
    best = PhaseError(float("inf"), 0.0)
    for sign in (1, -1):
        difference = sign * absolute[where].astype(np.float64) - true
        d = difference[np.isfinite(difference)]
        if not d.size:
            continue
        d = d - np.angle(np.exp(1j * d).mean())
        periods = np.rint(d / (2 * np.pi)).astype(np.int64)
        rms = float(np.sqrt(np.mean((d - 2 * np.pi * periods) ** 2)))
        share = float(np.bincount(periods - periods.min()).max() / difference.size)
        best = min(best, PhaseError(rms, share), key=lambda e: e.rms_rad)
    return best


def written(pair: StoredPair, case: Case, file: Path) -> None:
    """Write the peers' input: images, cameras and volume as plain arrays."""
    rig = case.layout.calibration_for(case.optics)
    volume = case.layout.volume()
    np.savez(
        file, left=pair.left, right=pair.right, periods=case.periods, projector=rig.projector.size,
        left_matrix=rig.left.matrix, left_distortion=rig.left.distortion,
        right_matrix=rig.right.matrix, right_distortion=rig.right.distortion,
        rotation=rig.right.rotation, translation=rig.right.translation, volume=(volume.near_mm, volume.far_mm),
    )  # fmt: skip


def compare(repeats: int, *, quick: bool) -> tuple[Table, dict[str, Any], list[tuple[str, bool]]]:
    """The table, plain figures by name, and the promised ratio with whether it is kept."""
    case, threads = CASES[0], THREADS[-1]
    pair = rendered.stored_pair(case)
    before = timed(case, [pair], threads, repeats)
    rows, found = peers(pair, case, threads, repeats, quick=quick)
    after, ours = measure(case, [pair], threads, repeats)
    # Measured before and after the peers, so that a machine that slows down favours neither.
    own = statistics.median(before.total_ms + after.total_ms)
    table = Table(
        "peers",
        f"The same images ({case.name}, {pair.left.shape[1]} x {pair.left.shape[0]}), {threads} threads",
        [
            "what", "called", "gives", "ms", "times ours", "within 1 mm %", "wrong %", "rms um", "phase rms rad",
            "period right %",
        ],
        text_columns=("called", "gives"),
    )  # fmt: skip
    e = phase_error(our_phase(case, pair), pair.truth_left, case)
    table.add(
        "fringed, a pair by itself", "Reconstructor.reconstruct", "depth", f"{own:.1f}", "1",
        *cells(ours), f"{e.rms_rad:.3f}", f"{100 * e.order:.1f}",
    )  # fmt: skip
    figures: dict[str, Any] = {"fringed": {"ms": own, "before_ms": before.total_ms, "after_ms": after.total_ms}}
    for row in rows:
        ms = statistics.median(row["ms"])
        figures[row["name"]] = {"ms": ms, "runs_ms": row["ms"], "unwrapping_ms": row.get("unwrapping_ms")}
        if row["gives"] == "depth":
            figures_of = (*cells(score(found[f"cloud_{row['key']}"], pair.truth_left)), "", "")
        else:
            e = phase_error(found[f"absolute_{row['key']}"], pair.truth_left, case)
            figures_of = ("", "", "", f"{e.rms_rad:.3f}", f"{100 * e.order:.1f}")
        table.add(row["name"], row["called"], row["gives"], f"{ms:.0f}", f"{ms / own:.1f}", *figures_of)
    chain = next(row for row in rows if row["key"] == "fringes_ski")
    ratio = statistics.median(chain["ms"]) / own
    unwrapping = statistics.median(chain["unwrapping_ms"])
    decoding = statistics.median(chain["ms"]) - unwrapping
    promise = f"fringes (decode, unwrap both images) against our whole pair: {ratio:.1f} : 1, promised {RATIO:.0f}"
    table.notes += [
        f"{promise}. That is with its default unwrapping, by scikit-image: {decoding:.0f} ms decoding and "
        f"{unwrapping:.0f} ms unwrapping; its decoding alone takes {decoding / own:.1f} times our whole pair.",
        "Both images each; medians, compiled beforehand, images and rectification maps in memory. Phase: left "
        "image, where lit and seen by both, without crosstalk correction but for ours; one constant is removed, as "
        "these phases have no absolute order. Period right: share of these pixels whose unwrapped phase is off by less "
        "than half a period once the most frequent whole number of periods is removed; unknown pixels are not right.",
    ]
    return table, figures, [(promise, ratio >= RATIO)]


def peers(
    pair: StoredPair, case: Case, threads: int, repeats: int, *, quick: bool
) -> tuple[list[dict[str, Any]], dict[str, Array]]:
    """Run the peers: a description and a result of each."""
    if not PYTHON.exists():
        raise SystemExit("the peers' environment .bench-venv is not there: run `make bench`, or give --no-peers")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "pair.npz", Path(folder) / "found.npz"
        written(pair, case, source)
        script = Path(__file__).with_name("peers.py")
        command: list[str | Path] = [PYTHON, script, source, target, str(repeats), str(threads)]
        subprocess.run([*command, *(["quick"] if quick else [])], env=environment(threads), timeout=900, check=True)
        with np.load(target) as arrays:
            found = dict(arrays)
    return json.loads(str(found.pop("rows"))), found


def our_phase(case: Case, pair: StoredPair) -> Array:
    """Absolute phase of the left image by this pipeline, NaN where unknown."""
    reconstructor = case.reconstructor()
    cloud = reconstructor.reconstruct(pair.left, pair.right)
    # The decoded phase is no part of a cloud; a benchmark may use internals.
    wrapped = reconstructor.decoders[0].decode(pair.left).phase
    return np.where(cloud.order >= 0, wrapped + 2 * np.pi * cloud.order, np.nan)
