"""Triangle meshes are met exactly, and a mesh of a ball is as good as the ball."""

from __future__ import annotations

import numpy as np
import pytest

from sim.render import render_pair
from sim.rig.optics import Optics
from sim.scene import named_scenes
from sim.scene.scene import Scene
from sim.scene.shapes import mesh, plane, sphere

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "ball.ply"
    trimesh.creation.icosphere(subdivisions=5, radius=3.0).export(path)
    return path


def test_a_mesh_of_a_ball_is_the_ball(ball, small):
    wall = plane().placed((0, 0, 80))
    meshed = Scene("mesh", (mesh(ball, 60.0).placed((10, -5, 0)), wall))
    exact = Scene("ball", (sphere(60).placed((10, -5, 0)), wall))
    ours, _ = render_pair.truths(small, meshed)
    true, _ = render_pair.truths(small, exact)
    same = np.abs(ours.xyz[..., 2] - true.xyz[..., 2]) < 0.15
    assert same.mean() > 0.98
    assert (ours.lit == true.lit).mean() > 0.99
    assert (ours.seen_by_both == true.seen_by_both).mean() > 0.99


def test_mesh_points_project_to_their_own_pixels(ball, small):
    truth, _ = render_pair.truths(small, Scene("mesh", (mesh(ball, 90.0).placed(turn=(0.2, 0.3, 0.1)),)))
    v, u = np.mgrid[0:102, 0:128]
    away = small.calibration().left.project(truth.xyz.astype(np.float64)) - np.stack([u, v], axis=-1)
    assert truth.hit.sum() > 1000
    assert np.nanmax(np.abs(away)) < 1e-3


def test_the_mesh_scene_renders_a_file_of_the_user(ball, small):
    pair = render_pair.render_pair(small, named_scenes.build("mesh", mesh_file=ball), small.pattern(), Optics())
    assert pair.left.max() > 100
    assert pair.truth_left.scorable.mean() > 0.3


@pytest.mark.parametrize("content", ["", "not a mesh", "v 0 0 0\n"])
def test_a_file_without_triangles_is_refused_by_name(content, tmp_path, small):
    path = tmp_path / "broken.obj"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"mesh .*broken\.obj"):
        render_pair.truths(small, named_scenes.build("mesh", mesh_file=path))


def test_a_missing_file_is_named(tmp_path, small):
    with pytest.raises(ValueError, match=r"gone\.obj: no such file"):
        render_pair.truths(small, named_scenes.build("mesh", mesh_file=tmp_path / "gone.obj"))
    with pytest.raises(ValueError, match="needs a file"):
        named_scenes.build("mesh")
