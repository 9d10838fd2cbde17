"""Meshes for collisions: `.collision.glb`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import random_scene, with_threads

from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.writing import write_scene
from gs_codec.formats import collision_mesh
from gs_codec.scene import Scene

open3d = pytest.importorskip("open3d", exc_type=ImportError)


#: Voxels in these tests.
VOXELS = 48


@pytest.fixture(autouse=True)
def coarse(monkeypatch) -> None:
    monkeypatch.setattr(collision_mesh, "_VOXELS", VOXELS)


def sphere(count: int, radius: float, centre: tuple[float, float, float], logit: float) -> Scene:
    """Flat Gaussians that cover a sphere."""
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(3, count))
    directions /= np.linalg.norm(directions, axis=0)
    # The quaternion that turns z into the direction.
    rot = np.stack([1 + directions[2], -directions[1], directions[0], 0 * directions[0]])
    scene = random_scene(count, 0)
    planes = {
        "positions": radius * directions + np.array(centre)[:, None],
        "opacity": np.full((1, count), logit),
        "log_scale": np.log(radius * np.array([0.08, 0.08, 1e-4]))[:, None] + np.zeros((3, count)),
        "rot": rot,
    }
    return replace(scene, **{name: plane.astype(np.float32) for name, plane in planes.items()})


def joined(*scenes: Scene) -> Scene:
    groups = ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot")
    return Scene(*(np.concatenate([getattr(s, g) for s in scenes], axis=1) for g in groups))


def mesh_of(path: Path):
    mesh = open3d.io.read_triangle_mesh(str(path))
    return np.asarray(mesh.vertices), mesh


def test_a_mesh_is_on_the_surface(tmp_path):
    """In the coordinates of glTF, without what is transparent, and without floaters."""
    ball = sphere(3000, 2.0, (5.0, -3.0, 1.0), 4.0)
    haze = sphere(3000, 1.0, (5.0, -3.0, 1.0), -4.0)
    floater = sphere(1, 0.4, (7.0, -1.0, 3.0), 6.0)
    path = tmp_path / "a.collision.glb"
    written = write_scene(path, joined(ball, haze, floater), Config())
    assert "only a mesh of " in written.lost[0]
    vertices, mesh = mesh_of(path)
    centre = np.array([-5.0, 3.0, 1.0])
    far = np.linalg.norm(vertices - centre, axis=1)
    voxel = 4 / VOXELS
    assert np.abs(far - 2).max() < 3 * voxel
    # A shell, with an outside and an inside.
    assert far.max() > 2 > far.min()
    assert mesh.is_watertight()
    assert 500 < len(mesh.triangles) < 20_000


def test_the_same_scene_gives_the_same_bytes(tmp_path):
    scene = sphere(500, 1.0, (0.0, 0.0, 0.0), 3.0)
    data = []
    for threads in (1, 2, 2):
        path = tmp_path / f"{len(data)}.collision.glb"
        with_threads(threads, lambda path=path: write_scene(path, scene, Config()))
        data.append(path.read_bytes())
    assert data[0] == data[1] == data[2]


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (sphere(50, 1.0, (0.0, 0.0, 0.0), -6.0), "nothing in the scene is solid"),
        (random_scene(0, 0), "no Gaussians"),
    ],
)
def test_scenes_without_surface_are_refused(scene, message, tmp_path):
    path = tmp_path / "a.collision.glb"
    with pytest.raises(InvalidInput, match=message):
        write_scene(path, scene, Config())
    assert not path.exists()


def test_one_point_is_a_mesh(tmp_path):
    """Its box has no extent."""
    write_scene(tmp_path / "a.collision.glb", sphere(1, 1.0, (1.0, 1.0, 1.0), 9.0), Config())
    vertices, _ = mesh_of(tmp_path / "a.collision.glb")
    assert np.isfinite(vertices).all()
