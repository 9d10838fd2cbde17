"""Gaussians in OpenUSD: `.usd`, `.usda`, `.usdc`, `.usdz`, as ParticleField3DGaussianSplat.

Values are centres, unit quaternions, linear scales, opacities 0-1, and SH, which are consecutive
for each Gaussian, SH-DC first, with the trainer's order and signs. Half floats are also read. Needs
usd-core.
"""

from __future__ import annotations

import io
import logging
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, ToolFailed
from gs_codec.format_table import USD, ZIP
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.extra_properties import left_out_of, say_degree_4, say_left_out
from gs_codec.formats.limits import EXPANSION, check_count, most_bytes, refusing
from gs_codec.formats.packed_values import (
    Clipped,
    check_finite,
    linear_scales,
    log_scales_of,
    logits_of,
    sigmoid,
    unit_quaternions,
)
from gs_codec.formats.similarity import move_scene
from gs_codec.formats.zip_file import write_zip
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.runtime.optional import check_installed, missing_package
from gs_codec.runtime.programs import Limits, run_on_files
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS, Scene, join_scenes, stated_comments

log = logging.getLogger(__name__)

#: Suffixes of layers.
LAYERS = (".usd", ".usda", ".usdc")

#: Message for a usd-core before 26.3.
WITHOUT_GAUSSIANS = "an OpenUSD without Gaussians"


_SYSTEM = USD.system
_SYSTEM_Z_UP = "RFU"

#: Files in a `.usdz` begin at multiples of this offset.
_MULTIPLE = 64

#: Size of a Gaussian, in standard deviations, in the extent of the scene.
_REACH = 3.0

#: Code of the reading process; its first argument is the folder of gs_codec. OpenUSD leaves crash
#: reports in `TMPDIR`, which is the process's own folder.
_READ = """
import os, sys
os.environ |= {"TMPDIR": os.getcwd(), "PXR_WORK_THREAD_LIMIT": "1"}  # others wait busily
sys.path[0] = sys.argv.pop(1)
from gs_codec.formats.usd.read_stage import main
main()
"""

#: The time before all others, at which the stage of a scene is read.
_EARLIEST = -sys.float_info.max

#: Maximum address space of that process without a scene, in bytes.
_SPACE = 4 << 30

#: Additional address space per byte of the scene's floats.
_TIMES_FLOATS = 4

#: Additional address space per byte of the file.
_TIMES_FILE = 64

#: Maximum time of that process without a scene, seconds.
_SECONDS = 20

#: Bytes of the file per additional second.
_BYTES_A_SECOND = 1 << 20


def require_usd_core() -> None:
    """Raise `MissingTool` if usd-core is not installed."""
    check_installed("pxr", "USD")


def is_usd(path: Path, data: FileBytes) -> bool:
    """Whether a file is not a zip, or its first entry is a USD layer."""
    if data[: len(ZIP)] != ZIP:
        return True
    name = bytes(data[30 : 30 + int.from_bytes(data[26:28], "little")])
    return name.lower().endswith(tuple(suffix.encode() for suffix in LAYERS))


def read_usd(path: Path, view: memoryview, max_bytes: int | None, time: float = _EARLIEST) -> Scene:
    """Read the bytes of a USD file, at one of its times; see `SceneFile.scene`."""
    with located(path):
        found = _read_in_process(view, most_bytes(len(view), max_bytes), time)
        check_count(*_total(found), len(view), max_bytes)
        _say_others(path, found, time)
        with refusing("USD"):
            return join_scenes(_scenes(found))


def _say_others(path: Path, found: dict[str, NDArray], time: float) -> None:
    """Log what the scene does not have of a stage, and what the stage does not have."""
    if found["has_degree_4"]:
        say_degree_4(path)
    if found["grey"]:
        log.warning("%s: without SH, read as grey: %s", path, counted(int(found["grey"]), "prim"))
    if time != _EARLIEST:  # a frame, of which there may be hundreds
        return
    say_left_out(path, lines={"prims that are not shown": int(found["hidden"])})
    if len(found["times"]) > 1:
        many = counted(len(found["times"]), "time")
        log.warning("%s: changes at %s; the first is read", path, many)


def stated_size(path: Path, view: memoryview) -> tuple[int, int]:
    """Number of Gaussians and SH degree of the stage; raises like `read_usd`."""
    with located(path):
        return _total(_read_in_process(view, -1))


def frame_times(path: Path, view: memoryview) -> tuple[list[float], float]:
    """Times at which the Gaussians change, ascending, and times per second."""
    with located(path):
        found = _read_in_process(view, -1)
        return found["times"].tolist(), float(found["rate"])


def _read_in_process(view: memoryview, most: int, time: float = _EARLIEST) -> dict[str, NDArray]:
    """The result of `read_stage.main`; only sizes if the floats take more than `most` bytes."""
    require_usd_core()
    suffix = dict(zip(USD.signatures, (".usda", ".usdc", ".usdz"), strict=True))
    name = "scene" + next((s for begin, s in suffix.items() if view[: len(begin)] == begin), ".usd")
    package = Path(__file__).parents[3]
    command = [sys.executable, "-c", _READ, str(package), name, "found.npz", str(most), repr(time)]
    floats, size = max(most, 0), len(view)
    seconds = _SECONDS + size // _BYTES_A_SECOND
    space = _SPACE + _TIMES_FLOATS * min(floats, EXPANSION * size) + _TIMES_FILE * size
    # Besides floats, there is a matrix for each prim, whose text takes at least as much.
    limits = Limits(10.0 * seconds, seconds, space)
    try:
        packed = run_on_files(command, {name: view}, "found.npz", limits, floats + size + (1 << 20))
    except ToolFailed as error:
        raise InvalidInput(f"USD: damaged: reading it {error}") from error
    with refusing("USD"), np.load(io.BytesIO(packed)) as file:
        found = {each: file[each] for each in file.files}
    if "refused" in found:
        raise InvalidInput(f"USD: {found['refused']}")
    return found


def _total(found: dict[str, NDArray]) -> tuple[int, int]:
    """Number of Gaussians of all prims, and their SH degree."""
    degrees = set(found["sizes"][:, 1].tolist())
    if len(degrees) > 1:
        raise InvalidInput("USD: prims of several SH degrees, expected one")
    return int(found["sizes"][:, 0].sum()), degrees.pop()


def _scenes(found: dict[str, NDArray]) -> list[Scene]:
    """The scene of each prim, transformed to the stage."""
    comments = stated_comments(_SYSTEM_Z_UP if found["z_up"] else _SYSTEM, False)
    count, degree = _total(found)
    sh = (
        found["radiance:sphericalHarmonicsCoefficients"]
        .reshape(count, SH_COEFFICIENTS[degree] + 1, 3)
        .transpose(2, 1, 0)
    )
    whole = Scene(
        np.ascontiguousarray(found["positions"].T),
        np.ascontiguousarray(sh[:, 0]),
        sh[:, 1:].reshape(3 * SH_COEFFICIENTS[degree], count),
        np.ascontiguousarray(logits_of(found["opacities"].T)),
        np.ascontiguousarray(log_scales_of(found["scales"].T)),
        found["orientations"].T[[3, 0, 1, 2]],
        comments=comments,
    )
    ends = np.cumsum(found["sizes"][:, 0]).tolist()
    return [
        move_scene(whole.between(start, end), matrix)
        for start, end, matrix in zip([0, *ends], ends, found["matrices"], strict=False)
    ]


def pack_usd(scene: Scene, suffix: str) -> tuple[bytes, tuple[str, ...]]:
    """The bytes of a file with this suffix, and sentences on what it cannot represent.

    Raises InvalidInput if a value is not finite, or a scale is too large for a float32. Raises
    MissingTool if usd-core is not installed.
    """
    require_usd_core()
    check_finite(scene, "USD")
    clipped = Clipped()
    stage = _stage(turn_axes(scene, _SYSTEM), clipped)
    name = f"scene{'.usdc' if suffix == '.usdz' else suffix}"
    with tempfile.TemporaryDirectory(prefix="gs_codec-") as folder:
        path = Path(folder, name)
        stage.GetRootLayer().Export(str(path))
        data = path.read_bytes()
    if suffix == ".usdz":
        zipped = io.BytesIO()
        write_zip(zipped, {name: data}, _MULTIPLE)
        data = zipped.getvalue()
    return data, (USD.rounding, *clipped.sentences(), *left_out_of(scene, USD))


def _stage(scene: Scene, clipped: Clipped) -> Any:
    """A stage with the scene as its only prim."""
    from pxr import Usd, UsdGeom, UsdVol, Vt

    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        raise missing_package("pxr", "USD", WITHOUT_GAUSSIANS)

    def rows(planes: NDArray) -> NDArray[np.float32]:
        with np.errstate(under="ignore"):
            return np.ascontiguousarray(planes.T, np.float32)

    stage = Usd.Stage.CreateInMemory("scene.usdc")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    splats = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Scene")
    stage.SetDefaultPrim(splats.GetPrim())
    scales = linear_scales(scene.log_scale.astype(np.float64), "USD", clipped)
    splats.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(rows(scene.positions)))
    rotations = rows(unit_quaternions(scene.rot)[[1, 2, 3, 0]])
    splats.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(rotations))
    splats.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(rows(scales)))
    share = sigmoid(scene.opacity[0].astype(np.float64))
    splats.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(rows(share)))
    coefficients = SH_COEFFICIENTS[scene.sh_degree]
    f_rest = scene.f_rest.reshape(3, coefficients, scene.count)
    sh = np.concatenate([scene.f_dc[:, None], f_rest], axis=1)
    colours = Vt.Vec3fArray.FromNumpy(rows(sh).reshape(-1, 3))
    radiance = UsdGeom.Primvar(splats.CreateRadianceSphericalHarmonicsCoefficientsAttr(colours))
    radiance.SetElementSize(1 + coefficients)
    radiance.SetInterpolation(UsdGeom.Tokens.vertex)
    splats.CreateRadianceSphericalHarmonicsDegreeAttr(scene.sh_degree)
    if scene.count:
        reach, most = _REACH * scales.max(axis=0), np.finfo(np.float32).max
        ends = [(scene.positions - reach).min(axis=1), (scene.positions + reach).max(axis=1)]
        extent = np.clip(ends, -most, most).astype(np.float32)
        splats.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent))
    return stage
