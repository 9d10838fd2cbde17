"""The plugin's additions to an Open3D window, tested without a window."""

from __future__ import annotations

import numpy as np
from scenes import random_scene

from gs_codec.cameras.inria import as_camera
from gs_codec.formats.cloud import to_cloud
from viewer.pictures.layers import error_legend, reason_colour
from viewer.pictures.notes import draw_notes
from viewer.scenes.choice import Appearance
from viewer.scenes.opened import Opened, Pruned
from viewer.scenes.pose import look_at
from viewer.scenes.viewpoints import nearest_camera
from viewer.window.pane import draws_splats, splat_material


def has(picture, colour) -> bool:
    """Whether a picture has a pixel of a colour, 0-1."""
    wanted = np.rint(255 * np.asarray(colour)).astype(int)
    return bool((np.asarray(picture).astype(int) == wanted).all(axis=2).any())


def test_notes_have_legends_and_reasons():
    pruned = Pruned(("geometry", "importance"), np.array([0, 1, 1, 2], np.uint8))
    plain = draw_notes("a caption")
    full = draw_notes("a caption", [error_legend("error")], pruned)
    assert full.height > plain.height + 50
    for colour in (reason_colour(0), reason_colour(1), error_legend("error").bar(2, 1)[0, -1]):
        assert has(full, colour)
        assert not has(plain, colour)


def test_notes_are_as_wide_as_their_caption_and_photographs_fit_in():
    red = np.zeros((300, 200, 3), np.float32)
    red[..., 0] = 1
    for caption, wide in (("short", 400), ("a long name " * 20, 1000)):
        notes = draw_notes(caption, photograph=red, most=120)
        assert notes.width >= wide
        shown = np.argwhere((np.asarray(notes) == (255, 0, 0)).all(axis=2))
        high, across = np.ptp(shown, axis=0) + 1
        assert (high, across) == (120, 80)
        assert has(notes, (1, 1, 1))  # the caption


def test_the_nearest_camera_is_near_and_looks_the_same_way():
    poses = [
        look_at(np.array(place, float), np.array(target, float))
        for place, target in (
            ((0, 0, -4), (0, 0, 0)),
            ((0, 0, -4.1), (0, 0, -9)),  # the same position, looking the other way
            ((3, 0, -4), (3, 0, 0)),
        )
    ]
    cameras = [
        as_camera(pose.camera(60, 40) | {"img_name": str(k)}) for k, pose in enumerate(poses)
    ]
    ahead = np.array([0.0, 0, 1])
    assert nearest_camera(cameras, np.array([0.0, 0, -4.2]), ahead).name == "0"
    assert nearest_camera(cameras, np.array([0.0, 0, -4.2]), -ahead).name == "1"
    assert nearest_camera(cameras, np.array([2.0, 0, -4.2]), ahead).name == "2"
    assert nearest_camera(cameras[:1], cameras[0].position, ahead).name == "0"


def test_splats_are_drawn_only_by_graphics_cards(monkeypatch):
    assert draws_splats("gpu")
    assert not draws_splats("cpu")
    monkeypatch.setattr("viewer.window.pane.rendering.MaterialRecord", object)
    assert not draws_splats("gpu")  # a version of Open3D without a splat shader


def test_the_shader_draws_large_splats():
    scene = Opened("a", to_cloud(random_scene(9, 1)))
    material = splat_material(scene, Appearance())
    assert material.gaussian_splat_max_tiles_per_splat == 1 << 16
    assert material.gaussian_splat_sh_degree == 1
