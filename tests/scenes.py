"""Scenes for the tests: small random ones, degenerate ones, and the shared real ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gs_codec.codecs import encode_scene
from gs_codec.codecs.adaptive.lattice import LARGEST, to_fixed
from gs_codec.codecs.adaptive.rotation import likeness
from gs_codec.codecs.adaptive.step_sizes import Sensitivity, StepSizes
from gs_codec.coding.clean import clean_scene
from gs_codec.config import Config, option
from gs_codec.guidance.guide import Guidance, steps_adding
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import ANTIALIASED, GROUPS, SH_COEFFICIENTS, Scene, join_scenes
from gs_codec.views import estimate as auto_cameras

SHARED = Path(__file__).parents[2] / "shared" / "scenes"
REAL_SCENES = ("bonsai/point_cloud.ply", "flowers_sh2.ply", "showroom_sh0.ply", "tiny_sh3.ply")


@dataclass(frozen=True)
class SmallBlocks(Config):
    """A configuration with blocks of any size; otherwise blocks have at least 1024 Gaussians."""

    block_size: int = option(16, "", kind=int, low=1, high=1 << 16)


def random_scene(count: int, sh_degree: int = 3, seed: int = 0) -> Scene:
    """Clustered centres, grey-ish colours, peaked SH-AC, bimodal opacity, raw quaternions."""
    rng = np.random.default_rng(seed)
    coefficients = SH_COEFFICIENTS[sh_degree]
    centres = np.take(rng.normal(size=(3, 8)), rng.integers(0, 8, count), axis=1)
    grey = rng.normal(size=(1, count))
    planes = {
        "positions": centres + rng.normal(scale=0.1, size=(3, count)),
        "f_dc": grey + rng.normal(scale=0.3, size=(3, count)),
        "f_rest": rng.laplace(scale=0.05, size=(3 * coefficients, count)),
        "opacity": rng.choice([-4.0, 6.0], size=(1, count)) + rng.normal(size=(1, count)),
        "log_scale": rng.normal(-5.0, 1.5, size=(3, count)),
        "rot": rng.normal(size=(4, count)),
    }
    return Scene(**{name: plane.astype(np.float32) for name, plane in planes.items()})


def seen_from(scene: Scene, directions: int, seed: int = 0, scale: float = 0.1) -> Scene:
    """The scene with SH-AC in a space of few dimensions, as cameras in few directions leave it."""
    rng = np.random.default_rng(seed)
    towards = rng.normal(size=(len(scene.f_rest) // 3, directions))
    planes = towards @ rng.laplace(scale=scale, size=(3, directions, scene.count))
    return replace(scene, f_rest=planes.reshape(scene.f_rest.shape).astype(np.float32))


def moved_apart(first: Scene, second: Scene) -> Scene:
    """Both scenes in one, with the second at larger x: so it comes second in stream order."""
    away = np.array([[100.0], [0.0], [0.0]], np.float32)
    return join_scenes([first, replace(second, positions=second.positions + away)])


def with_far(scene: Scene, number: int, seed: int = 0, lowest: float = 1e3) -> Scene:
    """The scene with some centres moved away, in random directions, to `lowest` up to 1e9.

    The first ones have the largest possible distance, some along a single axis.
    """
    rng = np.random.default_rng(seed)
    moved = rng.choice(scene.count, number, replace=False)
    away = rng.normal(size=(3, number))
    away *= 10 ** rng.uniform(np.log10(lowest), 9, number) / np.linalg.norm(away, axis=0)
    positions = scene.positions.copy()
    positions[:, moved] = away
    largest = float(np.finfo(np.float32).max)
    for place, far in zip(moved, ((-0.0, 0.0, -largest), (largest, largest, 1e9)), strict=False):
        positions[:, place] = far
    return replace(scene, positions=positions)


def edge_scenes() -> dict[str, Scene]:
    """Extreme valid scenes, by name."""
    base = random_scene(500, 3, seed=1)
    flat = base.positions.copy()
    flat[1] = 0.25
    line = base.positions.copy()
    line[:2] = 0.0
    doubled = base.take(np.repeat(np.arange(250), 2))
    outlier = base.f_rest.copy()
    outlier[3, 7] = 1e30
    tiny = (base.positions * np.float32(1e-38)).astype(np.float32)
    huge = (base.log_scale * np.float32(1e37)).astype(np.float32)
    two = np.where(base.opacity > 0, np.float32(5), np.float32(-5))
    sparse = np.where(np.abs(base.f_rest) > 0.2, base.f_rest, np.float32(0))
    return {
        "empty": random_scene(0),
        "one": random_scene(1),
        "two": random_scene(2),
        "five of degree 0": random_scene(5, 0),
        "identical": random_scene(1).take(np.zeros(1000, np.int64)),
        "plane": replace(base, positions=flat),
        "line": replace(base, positions=line),
        "one place": replace(base, positions=np.zeros_like(base.positions)),
        "pairs": doubled,
        "SH-AC outlier": replace(base, f_rest=outlier),
        "denormal positions": replace(base, positions=tiny),
        "huge range": replace(base, log_scale=huge),
        "two opacities": replace(base, opacity=two),
        "sparse SH-AC": replace(base, f_rest=sparse),
        "zero SH-AC": replace(base, f_rest=np.zeros_like(base.f_rest)),
        "constant green": replace(
            base, f_dc=np.stack([base.f_dc[0], np.ones(500, np.float32), base.f_dc[2]])
        ),
        "all colours constant": replace(base, f_dc=np.ones_like(base.f_dc)),
        "negative zero": replace(base, opacity=np.where(base.opacity > 0, -0.0, base.opacity)),
    }


#: Attributes and damaged values; infinite opacities and scales of 0 are not damage.
DAMAGE = [
    (group, value)
    for group in GROUPS
    for value in (np.nan, np.inf, -np.inf)
    if np.isnan(value) or (group != "opacity" and (group, value) != ("log_scale", -np.inf))
]


def assert_same_floats(first: Scene, second: Scene) -> None:
    """All floats are equal bit for bit."""
    for group in GROUPS:
        a, b = getattr(first, group), getattr(second, group)
        np.testing.assert_array_equal(a.view(np.uint32), b.view(np.uint32), err_msg=group)


def assert_same_bits(first: Scene, second: Scene) -> None:
    """The same floats, comments and extra properties."""
    assert_same_floats(first, second)
    assert (first.has_normals, first.comments) == (second.has_normals, second.comments)
    assert list(first.extra) == list(second.extra)
    for name, column in first.extra.items():
        assert (column.dtype, column.tobytes()) == (
            second.extra[name].dtype,
            second.extra[name].tobytes(),
        ), name


def with_threads(number: int | None, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function with this number of threads."""
    with using_threads(number):
        return function(*arguments)


def antialiased(scene: Scene, wanted: bool = True) -> Scene:
    """The scene marked as trained with opacity compensation, or without."""
    return replace(scene, comments=(ANTIALIASED,) if wanted else ())


#: Makes step sizes of a scene for a profile.
Guide = Callable[[Scene, Config], StepSizes]


def made_up_sensitivity(scene: Scene, seed: int = 0, spread: float = 3.0) -> Sensitivity:
    """Random sensitivities, as if measured in views.

    The sensitivities of a Gaussian vary together by ``exp(spread)``, so that Gaussians differ in
    class. The more similar two axes are, the lower the sensitivity to turns in their plane.
    """

    rng = np.random.default_rng(seed)
    level = rng.normal(0.0, spread, scene.count)

    def draw(*shape: int) -> np.ndarray:
        return np.exp(level + rng.normal(0.0, 0.5, (*shape, scene.count)))

    colour = 100.0 * np.exp(rng.normal(0.0, spread, scene.count))
    alike = likeness(to_fixed(scene.log_scale, LARGEST)[0])
    return Sensitivity(100.0 * draw(), draw(3), draw(3) * 4.0**-alike, draw(), colour)


def steps_for(
    scene: Scene, config: Config, sensitivity: Sensitivity, loss: float = 0.0
) -> StepSizes:
    """Step sizes from a sensitivity, for views of a thousand pixels per Gaussian."""
    return told(scene, sensitivity, loss).steps(config.adaptive_profile())


def told(scene: Scene, sensitivity: Sensitivity, loss: float = 0.0) -> Guidance:
    """Guidance from views of a thousand pixels per Gaussian, without compaction or refitting."""
    nothing = ReferenceViews((), (), False, (0.0, 0.0, 0.0))
    adding, weights = steps_adding(scene, sensitivity), np.zeros((0, scene.count))
    return Guidance(adding, loss, 1000 * scene.count, nothing, weights, np.arange(scene.count))


def made_up_guide(seed: int = 0, spread: float = 3.0, error: float | None = None) -> Guide:
    """Step sizes from random sensitivities; see `made_up_sensitivity`.

    They add the error that the profile allows, unless `error` is given.
    """

    def guide(scene: Scene, config: Config) -> StepSizes:
        profile, sensitivity = config.adaptive_profile(), made_up_sensitivity(scene, seed, spread)
        allowed = profile if error is None else replace(profile, error=error)
        return told(scene, sensitivity).steps(allowed)

    return guide


def encode_by(scene: Scene, config: Config, guide: Guide | None = None) -> bytes:
    """Encode a scene, with a guide if given and if the profile can use it."""
    steps = None
    if guide is not None and scene.count:
        steps = guide(clean_scene(scene, config)[0], config)
    return encode_scene(scene, config, steps=steps)[0]


def thorough(*values: Any) -> Any:
    """Parameter values that only `make test-all` tests."""
    return pytest.param(*values, marks=pytest.mark.thorough)


def estimate_few_cameras(patch: pytest.MonkeyPatch) -> None:
    """Estimate fewer and smaller cameras, to save most of the time."""
    for name in ("WIDTH", "HEIGHT", "SMALL", "_FOCAL", "_OVERVIEWS", "_LEAST_TRIED"):
        patch.setattr(auto_cameras, name, getattr(auto_cameras, name) // 6)
    patch.setattr(auto_cameras, "_THUMB", (32, 21))
    for name in ("_TRIED", "_MANY"):
        patch.setattr(auto_cameras, name, 1)


def shared_scene_path(name: str) -> Path:
    """Path of a real scene; skips the test if the shared scenes are missing."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"shared scene {name} is not on this machine")
    return path


#: Zeros, denormals, smallest and largest normal, infinities, quiet and signalling NaN.
PATTERNS = np.array(
    [
        *(0x00000000, 0x80000000, 0x00000001, 0x80000001, 0x007FFFFF, 0x00800000),
        *(0x7F7FFFFF, 0x7F800000, 0xFF800000, 0x7FC00000, 0xFFC00000, 0x7F800001),
        *(0xFFBFFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 0x3F800000),
    ],
    np.uint32,
)


def any_bits(count: int, sh_degree: int, seed: int) -> Scene:
    """Random bit patterns: NaN payloads, infinities, zeros of both signs, denormals."""
    rng = np.random.default_rng(seed)
    scene = random_scene(count, sh_degree, seed)
    for group in GROUPS:
        bits = getattr(scene, group).view(np.uint32)
        bits[:] = np.where(rng.random(bits.shape) < 0.3, rng.choice(PATTERNS, bits.shape), bits)
        wild = rng.integers(0, 1 << 32, bits.shape, np.uint32)
        bits[:] = np.where(rng.random(bits.shape) < 0.2, wild, bits)
    return scene


def rich_scene(count: int, degree: int) -> Scene:
    """A scene with comments, normals and extra properties."""
    rng = np.random.default_rng(7)
    extra = {"label": rng.integers(0, 200, count, np.uint8), "weight": rng.normal(size=count)}
    scene = random_scene(count, degree, seed=60)
    return replace(scene, comments=("a b", "c"), has_normals=True, extra=extra)
