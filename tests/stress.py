"""Scenes with extreme numbers: constant, huge, denormal, heavy-tailed, spatially degenerate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import GROUPS, Scene

Planes = dict[str, NDArray]


def stress_scenes(count: int, copies: int) -> Iterator[tuple[str, Scene]]:
    """Cases by name, of SH degree 1: most have `count` Gaussians, the last `copies` of one."""
    for few in range(6):
        yield f"{few} Gaussians", _scene(_usual(few))
    for name, planes in _values(count):
        yield name, _scene(planes)
    for name, planes in _places(count):
        yield name, _scene(planes)
    for name, planes in _shapes(count):
        yield name, _scene(planes)
    yield "copies of one", _scene(_usual(1)).take(np.zeros(copies, np.int64))


def _usual(count: int) -> Planes:
    """Planes with typical values."""
    rng = np.random.default_rng(count)
    return {
        "positions": rng.normal(size=(3, count)),
        "f_dc": rng.normal(size=(3, count)),
        "f_rest": rng.laplace(scale=0.05, size=(9, count)),
        "opacity": rng.normal(0.0, 4.0, size=(1, count)),
        "log_scale": rng.normal(-5.0, 1.5, size=(3, count)),
        "rot": rng.normal(size=(4, count)),
    }


def _scene(planes: Planes) -> Scene:
    floats: dict[str, Any] = {name: plane.astype(np.float32) for name, plane in planes.items()}
    return Scene(**floats)


def _values(count: int) -> Iterator[tuple[str, Planes]]:
    """Distributions of values, the same in every channel."""
    rng = np.random.default_rng([count, 1])
    usual = _usual(count)

    def every(change: Any) -> Planes:
        return {group: change(plane) for group, plane in usual.items()}

    yield "constant", every(lambda p: np.full_like(p, 0.25))
    yield "two values", every(lambda p: np.where(p > np.median(p), 3.0, -1.0))
    for group in GROUPS:
        planes = {name: plane.copy() for name, plane in usual.items()}
        planes[group][0, count // 2] = 1e30
        yield f"an outlier of 1e30 in {group}", planes
    yield "an outlier in each channel", every(_with_outliers)
    yield "denormals", every(lambda p: 1e-42 * p)
    yield "zeros of either sign", every(lambda p: np.where(p > 0, 0.0, -0.0))
    yield "a range of 1e-30", every(lambda p: 1e-30 * p)
    yield "a range of 1e30", every(lambda p: 1e30 * p)
    yield "two peaks far apart", every(lambda p: np.where(p > 0, 300.0, -300.0) + 1e-3 * p)
    yield "all but two in one bin", every(_in_one_bin)
    yield "less than a step apart", every(lambda p: 1.0 + 1e-7 * p)
    yield "heavy tails", every(lambda p: rng.standard_cauchy(p.shape))


def _with_outliers(plane: NDArray) -> NDArray:
    changed = plane.copy()
    changed[:, plane.shape[1] // 3] = -1e30
    changed[:, plane.shape[1] // 2] = 1e30
    return changed


def _in_one_bin(plane: NDArray) -> NDArray:
    changed = np.full_like(plane, 0.5)
    changed[:, 0], changed[:, -1] = -1.0, 2.0
    return changed


def _places(count: int) -> Iterator[tuple[str, Planes]]:
    """Arrangements of points."""
    usual = _usual(count)
    x, y, z = usual["positions"]
    flat = np.zeros_like(x)
    for name, positions in {
        "on a line": (x, flat, flat),
        "on a diagonal": (x, x, x),
        "on a plane": (x, y, flat + 2.5),
        "coordinates of 1e7, details of 1e-3": (1e7 + 1e-3 * x, 2e7 + y, -1e7 + 1e3 * z),
        "one of them far away": (np.where(np.arange(count) == 0, -3e38, x), y, flat - 3.4e38),
        "as far apart as floats are": (3.4e38 * np.sign(x), 3.4e38 * np.sign(y), z),
    }.items():
        yield name, {**usual, "positions": np.stack(positions)}


def _shapes(count: int) -> Iterator[tuple[str, Planes]]:
    """Opacities, scales and quaternions at the limits of their ranges."""
    usual = _usual(count)
    rot, sign = usual["rot"], np.sign(usual["log_scale"] + 5.0)
    infinite = np.where(usual["opacity"] > 0, np.inf, -np.inf)
    yield "opacity of +-infinity", {**usual, "opacity": infinite}
    yield "scales of exp(+-80)", {**usual, "log_scale": 80.0 * sign}
    yield "scales of exp(+-400)", {**usual, "log_scale": 400.0 * sign}
    for norm in (1e-20, 1e20, 0.0):
        yield f"quaternions of norm {norm:g}", {**usual, "rot": norm * rot}
