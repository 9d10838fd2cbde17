"""Read the stage of a USD file in a separate process, because the native code may crash.

Run by `usd.py`; arguments are the file, the output file, the maximum bytes of floats, and the time
at which attributes are read. It writes named NumPy arrays of all Gaussians. If it rejects the file,
it writes only the reason, as ``refused``.
"""

from __future__ import annotations

import os
import posixpath
import sys
import zipfile
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdVol

from gs_codec.errors import GsCodecError, InvalidInput, one_line
from gs_codec.formats.limits import FAILURES
from gs_codec.formats.usd.scene import LAYERS, WITHOUT_GAUSSIANS
from gs_codec.runtime.optional import missing_package
from gs_codec.scene import SH_COEFFICIENTS, float_bytes

_QUOTES = "'\" "
_COEFFICIENTS = "radiance:sphericalHarmonicsCoefficients"
_DEGREE = "radiance:sphericalHarmonicsDegree"

#: Optional attributes of a stage, and their default values (grey for SH).
_MISSING = {
    "orientations": (0, 0, 0, 1),
    "scales": (1, 1, 1),
    "opacities": (1,),
    _COEFFICIENTS: (0, 0, 0),
}

#: Exceptions for which a file is rejected; errors of OpenUSD are RuntimeErrors.
_REFUSALS: tuple[type[Exception], ...] = (GsCodecError, zipfile.BadZipFile, *FAILURES)


def main() -> None:
    """Read the file named in the arguments."""
    source, target, most, time = sys.argv[1:]
    try:
        arrays: dict[str, Any] = _arrays(source, int(most), Usd.TimeCode(float(time)))
    except _REFUSALS as error:
        arrays = {"refused": np.array(_why(error))}
    np.savez(target, **arrays)


def _why(error: Exception) -> str:
    """The reason for rejecting a file; for OpenUSD's errors, without its source locations."""
    if isinstance(error, GsCodecError):
        return str(error)
    try:
        reason = one_line(error).replace(f"{os.getcwd()}/", "").rpartition(" : ")[2]
        return f"damaged: {reason.strip(_QUOTES)[:100]}"
    except UnicodeDecodeError:  # the message quotes the file
        return "damaged: text that is not UTF-8"


def _arrays(source: str, most: int, time: Any) -> dict[str, NDArray]:
    """The arrays that `main` writes; only sizes if the floats take more than `most` bytes."""
    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        raise missing_package("pxr", "USD", WITHOUT_GAUSSIANS)
    _check_alone(source)
    stage = Usd.Stage.Open(source)
    every = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    found = [prim for prim in every if _is_splats(prim)]
    if not found:
        raise InvalidInput("no ParticleField3DGaussianSplat, not a scene of Gaussians")
    prims = [prim for prim in found if _is_shown(prim, time)] or found
    positions, sizes, total = [], [], 0
    degrees = [_degree(prim, time) for prim in prims]
    for prim, degree in zip(prims, degrees, strict=True):
        rows = _rows(prim, "positions", 3, time)
        if rows is None:
            raise InvalidInput("no positions, expected those of all Gaussians")
        sizes.append((len(rows), min(degree, 3)))
        total += float_bytes(*sizes[-1])
        if total <= most:
            positions.append(rows)
    arrays = {"sizes": np.array(sizes), "z_up": UsdGeom.GetStageUpAxis(stage) == "Z"}
    arrays["has_degree_4"] = np.array(4 in degrees)
    arrays["hidden"] = np.array(len(found) - len(prims))
    arrays["grey"] = np.array(sum(not _has_colours(prim) for prim in prims))
    arrays["times"], arrays["rate"] = _times(found), np.array(stage.GetTimeCodesPerSecond())
    if total > most or len({degree for _, degree in sizes}) > 1:
        return arrays
    arrays["positions"] = np.concatenate(positions)
    for name, missing in _MISSING.items():
        arrays[name] = np.concatenate([
            _first_rows(prim, name, missing, count, degree if name == _COEFFICIENTS else 0, time)
            for prim, (count, _), degree in zip(prims, sizes, degrees, strict=True)
        ])  # fmt: skip
    arrays["matrices"] = np.array([_placed(prim, time) for prim in prims])
    return arrays


def _check_alone(source: str) -> None:
    """Reject a file that references others; layers in a `.usdz` may reference one another."""
    inside: list[str] = []
    if source.endswith(".usdz"):
        with zipfile.ZipFile(source) as archive:
            inside = [name for name in archive.namelist() if _is_layer(name)]
    for name in inside or [""]:
        layer = Sdf.Layer.FindOrOpen(f"{source}[{name}]" if name else source)
        if not layer:
            raise InvalidInput(f"damaged: {name or 'the file'!a:.80} is not a layer")
        for other in _named(layer):
            if posixpath.normpath(posixpath.join(posixpath.dirname(name), other)) not in inside:
                raise InvalidInput(f"refers to {other!a:.80}, expected one file without references")


def _is_layer(name: str) -> bool:
    """Whether an entry of a zip is a USD layer inside it."""
    plain = posixpath.normpath(name) == name and not name.startswith(("/", ".."))
    return plain and "\\" not in name and name.endswith(LAYERS)


def _named(layer: Any) -> Iterator[str]:
    """The files from which a layer is composed."""
    yield from filter(None, layer.GetCompositionAssetDependencies())  # empty for this layer itself
    paths: list[Any] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    prims = [
        layer.GetPrimAtPath(path)
        for path in paths
        if path.IsPrimPath() or path.IsPrimVariantSelectionPath()
    ]
    if any(prim and prim.HasInfo("clips") for prim in prims):
        yield "value clips"


def _is_splats(prim: Any) -> bool:
    if not prim.IsA(UsdVol.ParticleField3DGaussianSplat):
        return False
    above = prim
    while above:
        space = above.GetAttribute("colorSpace:name").Get()
        if isinstance(space, str) and space.startswith("lin"):
            raise InvalidInput(f"colours in {space!a:.40}, expected sRGB")
        above = above.GetParent()
    return True


def _is_shown(prim: Any, time: Any) -> bool:
    """Whether renderers show a prim by default: visible, and neither a stand-in nor a guide."""
    image = UsdGeom.Imageable(prim)
    visible = image.ComputeVisibility(time) != UsdGeom.Tokens.invisible
    return visible and image.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)


def _has_colours(prim: Any) -> bool:
    names = (_COEFFICIENTS, f"{_COEFFICIENTS}h")
    return any(prim.GetAttribute(name).HasAuthoredValue() for name in names)


def _times(prims: Sequence[Any]) -> NDArray[np.float64]:
    """The times at which an attribute of a prim, its place or its visibility has a value."""
    times = set[float]()
    for prim in prims:
        for name in ("positions", *_MISSING):
            for each in (name, f"{name}h"):
                times.update(prim.GetAttribute(each).GetTimeSamples())
        while prim:
            placed = UsdGeom.Xformable(prim)
            times.update(placed.GetTimeSamples() if placed else ())
            seen = prim.GetAttribute(UsdGeom.Tokens.visibility)
            times.update(seen.GetTimeSamples() if seen else ())
            prim = prim.GetParent()
    return np.array(sorted(times), np.float64)


def _rows(prim: Any, name: str, width: int, time: Any) -> NDArray[np.float32] | None:
    """Rows of an attribute, from half floats if there are no floats; None if absent."""
    for each in (name, f"{name}h"):
        value = prim.GetAttribute(each).Get(time)
        if value is not None:
            with np.errstate(over="ignore"):  # reported later, as in a PLY
                return np.asarray(value, np.float32).reshape(-1, width)
    return None


def _first_rows(
    prim: Any, name: str, missing: Sequence[float], count: int, degree: int, time: Any
) -> NDArray[np.float32]:
    """The first rows of an attribute for `count` Gaussians, or its default values.

    SH rows are limited to degree 3, from an attribute of `degree`.
    """
    each = (degree + 1) ** 2
    rows = _rows(prim, name, len(missing), time)
    if rows is None:
        rows = np.full((each * count, len(missing)), missing, np.float32)
    if len(rows) < each * count:
        raise InvalidInput(f"{name} of {len(rows)}, expected {each * count}")
    kept = min(each, 1 + SH_COEFFICIENTS[-1])
    rows = rows[: each * count].reshape(count, each, len(missing))[:, :kept]
    return rows.reshape(kept * count, len(missing))


def _degree(prim: Any, time: Any) -> int:
    degree = prim.GetAttribute(_DEGREE).Get(time)
    if not isinstance(degree, int) or not 0 <= degree <= 4:
        raise InvalidInput(f"SH degree {degree!a:.20}, expected 0 to 4")
    return degree


def _placed(prim: Any, time: Any) -> NDArray[np.float64]:
    """Matrix ``(4, 4)`` that transforms columns from the prim to the stage."""
    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)).T
