"""Laws of the temporal prior: what a pair that follows others may gain from them, and what it must not lose."""

import dataclasses
import functools

import numpy as np
import pytest

from pipeline.reconstruct import first_pair
from sim.evaluate.score import score
from tests.pipeline.small import SETTINGS, images, pair, reconstructor, same, upright

AXES = pytest.mark.parametrize("axis", ["x", "y"])
FRAMES = range(6)


@functools.cache
def calibrated(axis, **options):
    """A reconstructor whose projector correction is that of the moving scene's first pair."""
    found = reconstructor(axis, **options)
    found.reconstruct(*images(pair("moving"), axis))
    return found


@functools.cache
def solitary(axis):
    """Another one, which never follows."""
    return calibrated.__wrapped__(axis)


def alone(axis, rendered):
    return solitary(axis).reconstruct(*images(rendered, axis))


@functools.cache
def followed(axis):
    """The clouds of the moving scene's frames, each following the one before."""
    found = calibrated(axis)
    found.clear_prior()
    return [found.reconstruct(*images(pair("moving", n), axis), use_prior=True) for n in FRAMES]


def judged(axis, rendered, cloud):
    return score(upright(cloud, axis)[0], rendered.truth_left)


@AXES
@pytest.mark.parametrize("number", FRAMES[1:])
def test_a_pair_with_prior_agrees_with_the_pair_alone(axis, number):
    rendered = pair("moving", number)
    one, other = alone(axis, rendered), followed(axis)[number]
    both = (one.order >= 0) & (other.order >= 0)
    assert (one.order != other.order)[both].mean() < 0.002
    before, after = judged(axis, rendered, one), judged(axis, rendered, other)
    assert abs(after.reconstructed - before.reconstructed) < 0.01
    assert after.wrong < before.wrong + 0.001


@AXES
def test_the_first_pair_is_searched_in_full(axis):
    assert same(followed(axis)[0], alone(axis, pair("moving")))


def test_a_search_with_prior_differs_from_a_full_search():
    # Without this the laws above would hold for a prior that does nothing: one that believes too much must show.
    found = calibrated.__wrapped__("x", settings=dataclasses.replace(SETTINGS, follow_cost=1.5))
    clouds = [found.reconstruct(*images(pair("moving", n)), use_prior=True) for n in (0, 1)]
    assert not same(clouds[1], alone("x", pair("moving", 1)))


@AXES
@pytest.mark.parametrize("scene", ["mixed", pytest.param("steps", marks=pytest.mark.long), "plane"])
def test_a_cut_to_another_scene_costs_nothing(axis, scene):
    found = calibrated(axis)
    found.clear_prior()
    for n in (0, 1):
        found.reconstruct(*images(pair("moving", n), axis), use_prior=True)
    for rendered in (pair(scene), pair("moving", 2)):
        after = judged(axis, rendered, found.reconstruct(*images(rendered, axis), use_prior=True))
        before = judged(axis, rendered, alone(axis, rendered))
        assert after.wrong < before.wrong + 0.002
        assert after.reconstructed > before.reconstructed - 0.01


@AXES
def test_a_pair_alone_does_not_depend_on_what_came_before(axis):
    rendered = pair("moving", 3)
    expected = alone(axis, rendered)
    found = calibrated(axis)
    for n in (0, 1, 2):
        found.reconstruct(*images(pair("moving", n), axis), use_prior=True)
    assert same(found.reconstruct(*images(rendered, axis)), expected)
    found.reconstruct(*images(pair("mixed"), axis), use_prior=True, stride=2)
    assert same(found.reconstruct(*images(rendered, axis)), expected)


@pytest.mark.threads
def test_results_with_prior_do_not_depend_on_the_number_of_threads():
    expected = followed("x")
    for threads in (1, 2):
        found = calibrated("x", threads=threads)
        found.clear_prior()
        for n in FRAMES[:4]:
            assert same(found.reconstruct(*images(pair("moving", n)), use_prior=True), expected[n])


def test_points_on_every_second_pixel_serve_the_next_pair_as_well():
    found, expected = calibrated("x"), followed("x")
    found.clear_prior()
    for n in FRAMES[:4]:
        cloud = found.reconstruct(*images(pair("moving", n)), use_prior=True, stride=1 + n % 2)
        if n % 2 == 0:
            assert same(cloud, expected[n])


def gap(found):
    found.reconstruct(*images(pair("mixed")))


def recalibration(found):
    maps = [decoder.decode(image) for decoder, image in zip(found.decoders, images(pair("moving")), strict=True)]
    first_pair.calibrate_columns(found, *maps)


@pytest.mark.parametrize(
    "ended_by", [gap, recalibration, lambda found: found.clear_prior(), lambda found: found.warm_up(use_prior=True)]
)
def test_the_first_pair_after_an_end_is_searched_in_full(ended_by):
    found = calibrated.__wrapped__("x")  # one of its own, which a recalibration may change for good
    for n in (0, 1):
        found.reconstruct(*images(pair("moving", n)), use_prior=True)
    ended_by(found)
    rendered = pair("moving", 2)
    assert same(found.reconstruct(*images(rendered), use_prior=True), alone("x", rendered))


def test_pairs_after_a_cleared_prior_are_as_after_a_start():
    found, expected = calibrated("x"), followed("x")
    for n in (3, 4, 5):
        found.reconstruct(*images(pair("moving", n)), use_prior=True)
    found.clear_prior()
    for n in FRAMES[:3]:
        assert same(found.reconstruct(*images(pair("moving", n)), use_prior=True), expected[n])


def test_no_error_outlives_a_round_of_the_refreshed_rows():
    # A still scene: what a wrong start left behind is searched again row by row, and all is as if searched in full.
    found, still = calibrated("x"), pair("mixed")
    found.clear_prior()
    found.reconstruct(*images(pair("moving")), use_prior=True)
    for _ in range(17):
        cloud = found.reconstruct(*images(still), use_prior=True)
    expected = alone("x", still)
    both = (cloud.order >= 0) & (expected.order >= 0)
    assert (cloud.order != expected.order)[both].mean() < 0.001
    assert np.mean((cloud.order >= 0) != (expected.order >= 0)) < 0.005
