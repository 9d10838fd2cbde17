"""PLY files of other programs: property names, filters, flat Gaussians, files without Gaussians.

FORMATS.md lists the programs.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import flat_scales
from gs_codec.errors import InvalidInput
from gs_codec.formats.extra_properties import listed
from gs_codec.formats.packed_values import spans
from gs_codec.formats.ply.ply_header import Element
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.wording import counted
from gs_codec.scene import FLAT, Scene, is_extra_name, render_mode

log = logging.getLogger(__name__)

#: Property of Mip-Splatting: standard deviation of the filter that is yet to be applied.
FILTER = "filter_3D"

#: Prefix of scalar fields written by CloudCompare, and by 3dgsconverter for it.
_SCALAR = re.compile("(?:scalar_|scal_)+(.+)", re.DOTALL)

#: Minimum number of Gaussians that show whether values are logits and logarithms.
_ENOUGH = 100

#: Properties of dynamic scenes: of SpacetimeGaussians and 4DGS.
_MOVING = re.compile(r"t|(?:motion|omega|f_t)_\d+|trbf_\w+|scale_t|(?:rot_r|rotr)_\d+", re.ASCII)


def layout_names(types: Mapping[str, str]) -> dict[str, str]:
    """Properties of a vertex, renamed to the layout's names if they correspond."""
    found = {name: _SCALAR.fullmatch(name) for name in types}
    bare = {name: match[1] for name, match in found.items() if match}
    known = {
        name: wanted
        for name, wanted in bare.items()
        if (wanted == FILTER or not is_extra_name(wanted)) and wanted not in types
    }
    if len({*known.values()}) < len(known):
        return dict(types)
    return {known.get(name, name): code for name, code in types.items()}


def with_halves(types: Mapping[str, str]) -> dict[str, str]:
    """Types of a vertex, with half floats instead of ``ushort`` in the layout.

    PLY has no type for half floats, so some programs state this one.
    """
    return {
        name: "f2" if code == "u2" and not is_extra_name(name) else code
        for name, code in types.items()
    }


def refuse_no_gaussians(elements: Mapping[str, Element]) -> None:
    """Reject a PLY without Gaussians, and name its content."""
    names = elements["vertex"].types
    if any(name.startswith("f_anchor_feat_") for name in names):
        raise InvalidInput(
            "anchors of Scaffold-GS, not Gaussians: a neural network generates those"
        )
    if not {"x", "y", "z"} <= {*names} or {"opacity", "scale_0", "f_dc_0"} & {*names}:
        return
    faces = elements["face"].count if "face" in elements else 0
    if faces:
        raise InvalidInput(
            f"a mesh of {counted(faces, 'face')} without opacity and scales, not Gaussians"
        )
    raise InvalidInput("a point cloud without opacity and scales, not Gaussians")


def moving(names: Collection[str]) -> list[str]:
    """Properties that describe motion; ``s`` and ``t`` together are texture coordinates."""
    known = [name for name in names if _MOVING.fullmatch(name)]
    return [name for name in known if name != "t" or "s" not in names]


def say_dialect(where: str | Path, names: Collection[str]) -> None:
    """Log how properties of other programs affect the appearance of a scene."""
    if FILTER in names:
        log.warning("%s: %s of Mip-Splatting fused into scales and opacity", where, FILTER)
    if is_flat(names):
        log.warning("%s: a 2DGS scene without scale_2; its Gaussians are flat", where)
    if moves := moving(names):
        log.warning(
            "%s: a 4D scene, read as a static one; these describe its motion: %s",
            where,
            listed(moves),
        )


def say_flat(where: str | Path) -> None:
    """Log that the Gaussians of a scene are read as flat."""
    log.warning("%s: a 2DGS scene; its Gaussians are flat", where)


def say_halves(where: str | Path, vertex: np.dtype) -> None:
    """Log which properties of a vertex are half floats; see `with_halves`."""
    halves = [name for name in vertex.names or () if vertex[name].char == "e"]
    if halves:
        log.warning("%s: 16-bit integers read as half floats: %s", where, listed(halves))


def say_linear(
    where: str | Path, opacity: NDArray[np.float32], log_scale: NDArray[np.float32]
) -> None:
    """Log that opacities or scales look linear, not like the logits and logarithms of trainers.

    Trained logits are not all from 0 to 1, nor are logarithms all positive and mostly below 1.
    """
    if opacity.size < _ENOUGH:
        return
    with np.errstate(invalid="ignore"):  # NaN
        looks = {
            "opacities (read as logits)": 0 <= opacity.min() < opacity.max() <= 1,
            "scales (read as logarithms)": 0 <= log_scale.min() < np.median(log_scale) < 1,
        }
    if found := [name for name, linear in looks.items() if linear]:
        log.warning("%s: these look linear, unlike a trainer's: %s", where, listed(found))


def is_flat(names: Collection[str]) -> bool:
    """Whether properties are those of 2D Gaussians."""
    return {"scale_0", "scale_1"} <= {*names} and "scale_2" not in names


def with_model(comments: tuple[str, ...], names: Collection[str]) -> tuple[str, ...]:
    """Comments of a PLY with these properties; of 2D Gaussians, they say so."""
    return (*comments, FLAT) if is_flat(names) and not render_mode(comments) else comments


def fuse_filter(
    log_scale: NDArray[np.float32], opacity: NDArray[np.float32], deviations: NDArray
) -> None:
    """Apply the 3D smoothing filter of Mip-Splatting (arXiv 2311.16493), in place.

    Each Gaussian is convolved with a Gaussian of standard deviation ``deviations (N,)``. Its
    opacity is multiplied by the square root of the ratio of the determinants, which preserves the
    mass.
    """
    for some in spans(len(deviations)):
        # Values may be infinite or NaN.
        with np.errstate(all="ignore"):
            before = log_scale[:, some].astype(np.float64)
            logit = opacity[0, some].astype(np.float64)
            added = 2 * np.log(np.abs(deviations[some].astype(np.float64)))
            after = np.logaddexp(2 * before, added) / 2
            factor = np.where(after == before, 0.0, before - after).sum(axis=0)
            share = factor - np.logaddexp(0, -logit)
            fused = share - np.log(-np.expm1(share))
            opacity[0, some] = np.where(factor == 0, logit, fused)
            log_scale[:, some] = after


def with_filter(where: str | Path, scene: Scene) -> Scene:
    """A scene with its separately stored filter applied; see `fuse_filter`."""
    if FILTER not in scene.extra:
        return scene
    say_dialect(where, scene.extra)
    extra = dict(scene.extra)
    fused = replace(scene, log_scale=scene.log_scale.copy(), opacity=scene.opacity.copy())
    fuse_filter(fused.log_scale, fused.opacity, extra.pop(FILTER))
    return replace(fused, extra=extra)


def with_flat(log_scale: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scales ``(3, N)`` of 2D Gaussians ``(2, N)``, whose third axis is their normal."""
    planes = empty((3, log_scale.shape[1]), np.float32)
    planes[:2], planes[2] = log_scale, flat_scales(log_scale)
    return planes
