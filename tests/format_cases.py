"""Files of every kind that FORMAT.md describes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scenes import random_scene, with_far

from gs_codec.codecs import encode_scene
from gs_codec.config import DEPTH_GROUPS, Config
from gs_codec.scene import Scene

#: Names of the properties of each attribute.
ROWS = {
    "positions": ("x", "y", "z"),
    "f_dc": ("f_dc_0", "f_dc_1", "f_dc_2"),
    "f_rest": tuple(f"f_rest_{i}" for i in range(45)),
    "opacity": ("opacity",),
    "log_scale": ("scale_0", "scale_1", "scale_2"),
    "rot": ("rot_0", "rot_1", "rot_2", "rot_3"),
}


def assert_same_values(scene: Scene, values: dict[str, np.ndarray], where: str = "") -> None:
    """The floats of a scene are those of the reference decoder, bit for bit."""
    rows = [
        (name, row)
        for group, names in ROWS.items()
        for name, row in zip(names, getattr(scene, group), strict=False)
    ]
    assert {name for name, _ in rows} == set(values)
    for name, row in rows:
        np.testing.assert_array_equal(row.view("u4"), values[name].view("u4"), f"{name}{where}")


def config(profile="paper-m", extra="error", models="best", **depths):
    depths = {"rotation": 6} | {group.replace("_", "-"): bits for group, bits in depths.items()}
    return Config(profile, depths, extra=extra, threads=1, block_size=1024, models=models)


def lattice_config(profile="m", extra="error"):
    return Config(profile, extra=extra, threads=1, block_size=1024)


def scene_of(seed, count, sh_degree=3):
    return random_scene(count, sh_degree, seed)


def with_rows(scene, group, values):
    """The scene with constants in some rows of a group: {row: value}."""
    plane = getattr(scene, group).copy()
    for row, value in values.items():
        plane[row] = value
    return replace(scene, **{group: plane})


def far_apart(seed, count):
    """Positions up to the largest float32, whose cells extend beyond it."""
    scene = random_scene(count, seed=seed)
    largest = np.finfo(np.float32).max
    positions = scene.positions / np.abs(scene.positions).max() * largest
    positions[:, 0], positions[:, 1] = -largest, largest
    # Large Gaussians, because small ones would be far.
    return replace(scene, positions=positions, log_scale=scene.log_scale + np.float32(80))


def some_far(seed, count, number):
    return with_far(random_scene(count, 2, seed=seed), number, seed)


def identical(seed, count):
    return random_scene(1, seed=seed).take(np.zeros(count, dtype=np.intp))


def duplicated(seed, count):
    """Each Gaussian several times, in random order."""
    return random_scene(count // 8, seed=seed).take(
        np.random.default_rng(seed).integers(0, count // 8, count)
    )


def one_place(seed, count):
    return with_rows(random_scene(count, seed=seed), "positions", {0: 0.5, 1: -2.0, 2: 7.25})


def few_levels(seed, count):
    """Opacities and scales with few distinct values, which no parametric model fits."""
    rng = np.random.default_rng(seed)
    opacity = rng.choice(
        [-5.0, -1.3, 0.2, 4.0, 9.0], size=(1, count), p=[0.4, 0.1, 0.3, 0.15, 0.05]
    )
    log_scale = rng.choice([-9.0, -7.0, -2.5, 0.0], size=(3, count), p=[0.5, 0.2, 0.2, 0.1])
    scene = random_scene(count, seed=seed)
    return replace(
        scene, opacity=opacity.astype(np.float32), log_scale=log_scale.astype(np.float32)
    )


def with_extra(seed, count):
    rng = np.random.default_rng(seed)
    extra = {
        "label": rng.integers(0, 5, count).astype(np.uint8),
        "offset": rng.integers(-128, 128, count).astype(np.int8),
        "rank": rng.integers(-30000, 30000, count).astype(np.int16),
        "tile": rng.integers(0, 65536, count).astype(np.uint16),
        "delta": rng.integers(-(2**31), 2**31, count).astype(np.int32),
        "id": rng.integers(0, 2**32, count).astype(np.uint32),
        "error": rng.normal(size=count).astype(np.float32),
        "time": rng.normal(size=count),
    }
    comments = ("trained for 30000 steps", "", "a\ttab")
    return replace(random_scene(count, 1, seed), has_normals=True, comments=comments, extra=extra)


def every_depth(bits):
    return {group.replace("-", "_"): bits for group in DEPTH_GROUPS}


CASES = {
    **{
        f"degree{degree}-seed{degree}": (scene_of, (degree, 200, degree), config())
        for degree in range(4)
    },
    **{f"count{count}-seed5": (scene_of, (5, count), config()) for count in (0, 1, 2, 33, 1500)},
    "count0-degree0-seed5": (scene_of, (5, 0, 0), config()),
    "count1024-degree0-seed5": (scene_of, (5, 1024, 0), config()),
    "count1025-degree0-seed5": (scene_of, (5, 1025, 0), config()),
    "identical-seed6": (identical, (6, 1100), config()),
    "duplicated-seed7": (duplicated, (7, 1500), config()),
    "one-place-seed8": (one_place, (8, 1100), config()),
    "few-levels-seed9": (few_levels, (9, 1500), config()),
    "all-1-bit-seed10": (scene_of, (10, 400), config(**every_depth(1))),
    "all-12-bits-seed11": (scene_of, (11, 400), config(**every_depth(12))),
    "12-bits-blocks-seed12": (scene_of, (12, 1500, 0), config(**every_depth(12))),
    "geometry21-seed13": (scene_of, (13, 1500, 0), config(geometry=21)),
    **{
        f"{profile}-seed14": (scene_of, (14, 300), config(profile, models="parametric"))
        for profile in ("paper-l", "paper-m", "paper-s")
    },
    "extra-seed15": (with_extra, (15, 1100), config(extra="keep")),
}


@cache
def encoded(case):
    make, arguments, settings = CASES[case]
    return encode_scene(make(*arguments), settings)


LATTICE_CASES = {
    **{f"degree{degree}-seed{degree}": (scene_of, (degree, 200, degree)) for degree in range(4)},
    **{f"count{count}-seed5": (scene_of, (5, count)) for count in (0, 1, 2, 31, 33)},
    "blocks-seed5": (scene_of, (5, 1500)),
    "blocks-of-degree0-seed5": (scene_of, (5, 2049, 0)),
    "identical-seed6": (identical, (6, 1100)),
    "duplicated-seed7": (duplicated, (7, 1100)),
    "one-place-seed8": (one_place, (8, 200)),
    "few-levels-seed9": (few_levels, (9, 300)),
    "far-apart-seed16": (far_apart, (16, 50)),
    "one-far-seed17": (some_far, (17, 50, 1)),
    "many-far-seed18": (some_far, (18, 1100, 400)),
    "two-far-seed19": (some_far, (19, 3, 2)),
}
