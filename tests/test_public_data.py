"""Real images that others took: the command a user would type, and the phase formulas."""

import json

import cv2
import numpy as np
import pytest

from daemon.cli import entry

pytestmark = pytest.mark.shared


def test_the_bust_is_measured_with_the_settings_of_the_simulated_scenes(shared_data, tmp_path):
    assert entry.run(["replay", str(shared_data("bust", "take.mcap")), "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["pairs"] == summary["clouds"] == 1
    xyz = np.load(tmp_path / "cloud_000000.npz")["xyz"]
    reference = np.load(shared_data("bust", "reference.npz"))["xyz"]
    claimed = np.isfinite(reference[..., 2])
    error = np.linalg.norm(xyz - reference, axis=-1)[claimed]
    found = np.isfinite(error)
    assert (error[found] < 3).sum() / claimed.sum() >= 0.94
    assert (error[found] > 20).sum() / found.sum() <= 0.0003


@pytest.mark.parametrize(
    ("name", "suffix", "axis", "period", "grows"),
    [
        ("head_color", "jpg", 0, 25.9, -1),
        ("face", "png", 0, 60.0, None),
        ("zebra", "png", 1, 32.1, -1),
    ],
)
def test_three_real_images_shifted_by_120_degrees_give_the_known_fringes(
    shared_data, name, suffix, axis, period, grows
):
    """Each set's README gives period, direction and share of valid pixels; here by the pipeline's own solution."""
    from pipeline.decode.decoder import design
    from pipeline.pattern.color_fringe import ColorFringe
    from pipeline.rig.calibration import ColorModel

    images = [
        cv2.imread(str(shared_data("threephase", name, f"phase{k}.{suffix}")), cv2.IMREAD_GRAYSCALE) for k in (1, 2, 3)
    ]
    counts = np.stack(images, axis=-1).astype(np.float64)
    mean, c, s = np.moveaxis(counts @ np.linalg.inv(design(ColorModel(), ColorFringe().shifts)).T, -1, 0)
    modulation = np.hypot(c, s)
    red, green, blue = np.moveaxis(counts, -1, 0)
    formula = np.arctan2(np.sqrt(3) * (red - blue), 2 * green - red - blue)
    assert np.abs(np.angle(np.exp(1j * (np.arctan2(s, c) - formula))))[modulation > 1].max() < 1e-9
    assert np.abs(mean - counts.mean(axis=-1)).max() < 1e-9
    valid = (modulation > 12) & (counts.max(axis=-1) < 254)
    assert 0.3 < valid.mean() < 0.7
    step = np.angle(np.exp(1j * np.diff(np.arctan2(s, c), axis=axis)))
    both = valid[1:] & valid[:-1] if axis == 0 else valid[:, 1:] & valid[:, :-1]
    slope = np.median(step[both])
    assert abs(2 * np.pi / abs(slope) / period - 1) < 0.15
    if grows is not None:
        assert np.sign(slope) == grows
