"""Sets of images become clouds that are true, by every mode and every kind of camera."""

import numpy as np
import pytest

from pipeline.common.errors import CalibrationError, ImageError, PatternError
from pipeline.common.settings import Settings
from pipeline.multi_frame.set_reconstructor import SetReconstructor
from pipeline.pattern.mode_sequences import MODES, mode_sequence
from sim.evaluate.score import score
from sim.rig.optics import Optics
from tests.pipeline.multi_frame.sets import LAYOUT, OPTICS, SETTINGS, in_motion, made, sequence, taken, truth

KINDS = [
    ("heterodyne", "rgb8"), ("heterodyne", "bayer_rggb8"), pytest.param("heterodyne", "mono16", marks=pytest.mark.long),
    ("gray", "rgb8"), ("gray", "mono8"), ("two_color", "rgb8"), ("two_color", "bayer_rggb8"),
    pytest.param("heterodyne", "mono8", marks=pytest.mark.long),
    pytest.param("gray", "bayer_rggb8", marks=pytest.mark.long),
]  # fmt: skip


@pytest.mark.parametrize(("mode", "encoding"), KINDS)
def test_a_scene_at_rest_is_measured(mode, encoding):
    cloud = made(mode, encoding).reconstruct(*taken(mode, encoding))
    found = score(cloud.xyz, truth())
    gray = mode != "two_color"
    assert found.reconstructed > (0.86 if gray else 0.75)
    assert found.wrong < (0.012 if gray else 0.06)
    assert found.rms_mm < (0.3 if gray else 0.45)
    assert cloud.moved < 0.02 * cloud.gray.size


@pytest.mark.parametrize("mode", ["heterodyne", "gray"])
def test_errors_agree_with_sigma(mode):
    cloud, true = made(mode).reconstruct(*taken(mode, scene="plane")), truth("plane").xyz
    valid = np.isfinite(cloud.sigma_mm)
    error = np.linalg.norm(cloud.xyz - true, axis=-1)[valid] / cloud.sigma_mm[valid]
    assert 0.5 < np.median(np.abs(error)) / 0.6745 < 1.6


@pytest.mark.parametrize(
    ("mode", "speed_m_s"),
    [
        ("heterodyne", 0.3),
        pytest.param("gray", 1.0, marks=pytest.mark.long),
        pytest.param("heterodyne", 1.0, marks=pytest.mark.long),
        pytest.param("gray", 0.3, marks=pytest.mark.long),
    ],
)
def test_moving_surfaces_are_unknown_rather_than_wrong(mode, speed_m_s):
    reconstructor = made(mode)
    cloud = reconstructor.reconstruct(*in_motion(mode, speed_m_s))
    assert cloud.points < 0.02 * cloud.gray.size
    assert cloud.moved > 0.8 * cloud.gray.size
    # Nothing was learned from it, and the next set is as good as any.
    assert not reconstructor.correction.any()
    assert reconstructor.reconstruct(*taken(mode)).points > 0.5 * cloud.gray.size


def test_two_colours_measure_with_images_of_one_instant():
    cloud = made("two_color").reconstruct(*in_motion("two_color", 0.1))
    valid = np.isfinite(cloud.xyz[..., 2])
    assert valid.mean() > 0.8
    # The plane passes the place of the one at rest at the begin of the first exposure of 8 ms.
    still = made("two_color").reconstruct(*taken("two_color", scene="plane"))
    away = (cloud.xyz - still.xyz)[..., 2][valid & np.isfinite(still.xyz[..., 2])]
    assert abs(np.median(away) - 0.4) < 0.25


def test_an_uncalibrated_response_of_the_projector_is_not_taken_for_motion():
    optics = Optics(gamma=2.2, precorrected=False)
    for mode in ("heterodyne", "gray"):
        cloud = made(mode, optics=optics).reconstruct(*taken(mode, optics=optics))
        assert score(cloud.xyz, truth()).reconstructed > 0.85
        assert cloud.moved < 0.02 * cloud.gray.size


def test_misregistered_projector_colours_do_not_affect_a_mosaic():
    optics = Optics.realistic()
    cloud = made("heterodyne", "bayer_rggb8", optics).reconstruct(*taken("heterodyne", "bayer_rggb8", optics=optics))
    assert score(cloud.xyz, truth()).rms_mm < 0.3


def test_a_saturated_channel_is_left_out():
    optics = Optics(exposure=1.9)
    cloud = made("heterodyne", optics=optics).reconstruct(*taken("heterodyne", optics=optics))
    found = score(cloud.xyz, truth())
    assert cloud.saturated[0] > 0.1
    assert found.reconstructed > 0.75
    assert found.wrong < 0.015


@pytest.mark.threads
def test_the_result_depends_neither_on_earlier_sets_nor_on_the_number_of_threads():
    for mode in MODES:
        fresh, other = made(mode, threads=1), made(mode, threads=2)
        other.warm_up(strides=(1, 2))
        first, second = fresh.reconstruct(*taken(mode)), other.reconstruct(*taken(mode))
        assert (other.correction == fresh.correction).all()
        for name in ("xyz", "sigma_mm", "gray", "order"):
            assert getattr(first, name).tobytes() == getattr(second, name).tobytes(), (mode, name)
        again = fresh.reconstruct(*taken(mode))
        fresh.reconstruct(*taken(mode, scene="plane"))
        assert fresh.reconstruct(*taken(mode)).xyz.tobytes() == again.xyz.tobytes()


def test_points_on_every_second_pixel_are_those_of_the_whole_cloud():
    reconstructor = made("heterodyne", settings=Settings(cluster_min_area=20, self_calibrate=False))
    whole, part = (reconstructor.reconstruct(*taken("heterodyne"), stride=n) for n in (1, 2))
    both = np.isfinite(whole.xyz[..., 2]) & np.isfinite(part.xyz[..., 2])
    assert both[::2, ::2].mean() > 0.6
    assert not np.isfinite(part.xyz[1::2]).any()
    assert np.abs(whole.xyz - part.xyz)[both].max() < 1e-3


def test_a_projector_that_was_moved_is_found_again():
    optics = Optics(projector_error_px=(0.5, 0.2))
    reconstructor = made("heterodyne", optics=optics)
    cloud = reconstructor.reconstruct(*taken("heterodyne", optics=optics))
    assert abs(reconstructor.correction[0]) > 0.2
    assert score(cloud.xyz, truth()).reconstructed > 0.88


def test_images_that_do_not_fit_are_refused_by_name():
    reconstructor, (lefts, rights) = made("heterodyne"), taken("heterodyne")
    with pytest.raises(ImageError, match="11 right images of a set of 12"):
        reconstructor.reconstruct(lefts, rights[1:])
    with pytest.raises(ImageError, match="left image 3 of the set is uint16"):
        reconstructor.reconstruct([*lefts[:3], lefts[3].astype(np.uint16), *lefts[4:]], rights)
    with pytest.raises(ImageError, match="1 left images of a set of 2"):
        made("two_color").reconstruct(lefts[:1], rights[:1])


def test_unsuitable_sequences_are_rejected():
    calibration, volume = LAYOUT.calibration_for(OPTICS), LAYOUT.volume()
    with pytest.raises(CalibrationError, match=r"pattern\.size"):
        SetReconstructor(calibration, mode_sequence("gray", (640, 480), periods=40), volume)
    with pytest.raises(ImageError, match="encoding 'yuv'"):
        SetReconstructor(calibration, sequence("gray"), volume, encoding="yuv")
    with pytest.raises(ImageError, match="no three colours"):
        SetReconstructor(calibration, sequence("two_color"), volume, encoding="mono8")
    with pytest.raises(PatternError, match="one fringe"):
        from pipeline.pattern.sequence import FrameSequence

        SetReconstructor(calibration, FrameSequence("x", sequence("gray").frames[:4]), volume, settings=SETTINGS)


def test_an_empty_scene_gives_no_points():
    for mode in MODES:
        dark = [np.full_like(image, 5) for image in taken(mode)[0]]
        cloud = made(mode).reconstruct(dark, dark)
        assert cloud.points == cloud.moved == 0
