"""Tensors of trainers: one array per attribute, with one row per Gaussian."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.extra_properties import say_degree_4
from gs_codec.formats.packed_values import sh_of_colours, sigmoid
from gs_codec.formats.ply.dialects import say_flat, with_flat
from gs_codec.runtime.wording import counted
from gs_codec.scene import DEGREE_4, FLAT, SH_COEFFICIENTS, Scene

#: gsplat's names of tensors, and nerfstudio's names for two of them.
NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN")
NERFSTUDIO = {"features_dc": "sh0", "features_rest": "shN"}


def tensors_of(scene: Scene) -> dict[str, NDArray[np.float32]]:
    """Arrays with gsplat's names, before activation; see `to_tensors` for shapes."""
    rest = scene.f_rest.reshape(3, len(scene.f_rest) // 3, scene.count)
    return {
        "means": np.array(scene.positions.T, order="C"),
        "quats": np.array(scene.rot.T, order="C"),
        "scales": np.array(scene.log_scale.T, order="C"),
        "opacities": scene.opacity[0].copy(),
        "sh0": np.array(scene.f_dc.T[:, None], order="C"),
        "shN": np.array(rest.transpose(2, 1, 0), order="C"),
    }


def _by_our_names(tensors: Mapping[str, Any]) -> dict[str, Any]:
    """Tensors renamed to gsplat's names; `InvalidInput` if two names coincide."""
    named = {NERFSTUDIO.get(name, name): tensor for name, tensor in tensors.items()}
    if len(named) < len(tensors):
        raise InvalidInput(f"tensors {', '.join(tensors)}: some have two names")
    return named


def check_shapes(tensors: Mapping[str, Any]) -> tuple[int, int]:
    """Number of Gaussians and SH degree, from the shapes of tensors with either trainer's names.

    Raises InvalidInput if one is missing, duplicated or unknown, or their shapes do not match.
    """
    shapes: dict[str, tuple[int, ...]] = {n: t.shape for n, t in _by_our_names(tensors).items()}
    missing = [name for name in NAMES if name not in shapes and name != "shN"]
    if missing:
        raise InvalidInput(f"tensor '{missing[0]}': missing, expected {', '.join(NAMES)}")
    unknown = [name for name in shapes if name not in NAMES]
    if unknown:
        raise InvalidInput(f"tensor '{unknown[0]}': not known, expected {', '.join(NAMES)}")
    count = shapes["means"][0] if shapes["means"] else 0
    coefficients = (*shapes.get("shN", (count, 0, 3)), 0, 0)[1]
    if coefficients not in (*SH_COEFFICIENTS, DEGREE_4):
        known = ", ".join(map(str, SH_COEFFICIENTS))
        raise InvalidInput(
            f"tensor 'shN': {counted(coefficients, 'coefficient')}, expected one of {known}"
        )
    expected: dict[str, list[tuple[int, ...]]] = {
        "means": [(count, 3)],
        "quats": [(count, 4)],
        "scales": [(count, 3), (count, 2)],  # of 3D and of 2D Gaussians
        "opacities": [(count,), (count, 1)],
        "sh0": [(count, 1, 3), (count, 3)],
        "shN": [(count, coefficients, 3)],
    }
    for name, shape in shapes.items():
        if shape not in expected[name]:
            raise InvalidInput(f"tensor '{name}': shape {shape}, expected {expected[name][0]}")
    return count, SH_COEFFICIENTS.index(min(coefficients, SH_COEFFICIENTS[-1]))


def scene_of_tensors(tensors: Mapping[str, NDArray], where: str | Path = "tensor 'shN'") -> Scene:
    """The scene of arrays with gsplat's or nerfstudio's names; raises like `check_shapes`.

    `where` is the prefix of warnings.
    """
    count, degree = check_shapes(tensors)
    named = _by_our_names(tensors)
    for name, array in named.items():
        if array.dtype.kind != "f":
            raise InvalidInput(f"tensor '{name}': {array.dtype}, expected floats")
    coefficients = SH_COEFFICIENTS[degree]

    def planes(name: str, rows: int) -> NDArray[np.float32]:
        with np.errstate(over="ignore"):
            return np.array(named[name].reshape(count, rows).T, np.float32, order="C")

    f_dc = planes("sh0", 3)
    # Without SH-AC, nerfstudio's values are colours before the sigmoid.
    if "features_dc" in tensors and not degree:
        f_dc = sh_of_colours(sigmoid(f_dc.astype(np.float64)))
    f_rest = np.empty((3, coefficients, count), np.float32)
    if coefficients:
        f_rest[:] = named["shN"][:, :coefficients].transpose(2, 1, 0)
        if named["shN"].shape[1] == DEGREE_4:
            say_degree_4(where)
    is_flat = named["scales"].shape[1] == 2
    if is_flat:
        say_flat(where)
    return Scene(
        planes("means", 3),
        f_dc,
        f_rest.reshape(3 * coefficients, count),
        planes("opacities", 1),
        with_flat(planes("scales", 2)) if is_flat else planes("scales", 3),
        planes("quats", 4),
        comments=(FLAT,) if is_flat else (),
    )
