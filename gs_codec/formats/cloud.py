"""Convert scenes from and to Open3D point clouds, sharing memory if layouts allow."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import with_finite_ends
from gs_codec.config import Extra
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import state_system, turn_axes
from gs_codec.formats.extra_properties import listed, say_left_out
from gs_codec.runtime.optional import needed
from gs_codec.runtime.wording import counted
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene, group_rows

if TYPE_CHECKING:
    import open3d

log = logging.getLogger(__name__)

#: Attributes of a cloud that are not extra properties.
_KNOWN = {*GROUPS, "scale", "normals"}


def to_cloud(scene: Scene) -> open3d.t.geometry.PointCloud:
    """A point cloud whose attributes share memory with the scene if layouts allow.

    A cloud cannot state its coordinate system, so every cloud is ``RDF``: a scene in another
    system is converted. Attributes are those that `gs_codec.read` lists, zero ``normals (N, 3)``
    if the scene has them, and its extra properties ``(N, 1)``.
    """
    open3d = needed("open3d", "a scene as a point cloud")
    scene = turn_axes(scene)
    tensor = open3d.core.Tensor.from_numpy
    coefficients = SH_COEFFICIENTS[scene.sh_degree]
    attributes = {
        "positions": scene.positions.T,
        "f_dc": scene.f_dc.T,
        "f_rest": scene.f_rest.reshape(3, coefficients, scene.count).transpose(2, 1, 0),
        "opacity": scene.opacity.T,
        "log_scale": scene.log_scale.T,
        "scale": _exponential(scene.log_scale).T,
        # A copy: Open3D's `rotate` expects each quaternion to be contiguous in memory.
        "rot": np.ascontiguousarray(scene.rot.T),
    }
    if scene.has_normals:
        attributes["normals"] = np.zeros((scene.count, 3), np.float32)
    say_left_out("a cloud", sorted(_KNOWN & set(scene.extra)))
    attributes |= {n: column[:, None] for n, column in scene.extra.items() if n not in _KNOWN}
    cloud = open3d.t.geometry.PointCloud()
    for name, array in attributes.items():
        cloud.point[name] = tensor(array)
    return cloud


def public_cloud(scene: Scene) -> open3d.t.geometry.PointCloud:
    """Like `to_cloud`; a warning says that the antialias flag is not kept."""
    if scene.antialiased:
        log.warning(
            "a cloud does not keep the antialias flag: pass the path instead, or antialiased to "
            "render"
        )
    return to_cloud(scene)


def check_cloud(cloud: Any) -> None:
    """Raise `InvalidInput` unless the argument is an Open3D point cloud."""
    open3d = needed("open3d", "a scene as a point cloud")
    if not isinstance(cloud, open3d.t.geometry.PointCloud):
        given = "None" if cloud is None else type(cloud).__name__
        raise InvalidInput(f"scene: {given}, expected an open3d.t.geometry.PointCloud")


def from_cloud(
    cloud: open3d.t.geometry.PointCloud,
    extra: Extra = "error",
    tell: bool = True,
    exact: bool = False,
) -> Scene:
    """The scene of a point cloud with the attributes that `gs_codec.read` lists.

    One of ``log_scale`` and ``scale`` is enough. If both are present, they must agree, so that an
    edit of one is never ignored. `extra` controls other attributes, and normals that are not all
    zero; if `tell`, a log message names those that are dropped. Valid infinities become finite (see
    `finite_ends`), unless `exact`. Raises InvalidInput if an attribute is missing, has a wrong
    shape, or is not float32, or if ``scale`` is not the exponential of ``log_scale``.
    """
    check_cloud(cloud)
    arrays = {name: cloud.point[name].cpu().numpy() for name in cloud.point}
    if "scale" in arrays:
        linear = _plane(arrays, "scale", (3,))
        if "log_scale" in arrays:
            _check_scales(linear, _plane(arrays, "log_scale", (3,)))
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                arrays["log_scale"] = np.log(linear).T
    arrays.setdefault("f_rest", np.zeros((len(arrays.get("positions", ())), 0, 3), np.float32))
    rows = group_rows(0)
    planes: dict[str, Any] = {n: _plane(arrays, n, (rows[n],)) for n in GROUPS if n != "f_rest"}
    rest = arrays["f_rest"]
    if rest.ndim != 3 or rest.shape[2] != 3 or rest.dtype != np.float32:
        raise InvalidInput(f"f_rest: {rest.dtype} {rest.shape}, expected float32 (N, K, 3)")
    planes["f_rest"] = np.ascontiguousarray(
        rest.transpose(2, 1, 0).reshape(3 * rest.shape[1], rest.shape[0])
    )
    others = [name for name in arrays if name not in _KNOWN]
    zero_normals = "normals" in arrays and not arrays["normals"].any()
    if "normals" in arrays and not zero_normals:
        others.append("normals")
    if extra == "error" and others:
        named = "normals that are not all zero" if others == ["normals"] else listed(others)
        raise InvalidInput(f"attributes beyond the layout: {named}; choose extra keep or drop")
    if extra == "drop" and tell:
        say_left_out("a cloud", others)
    kept: dict[str, NDArray] = {}
    for name in others if extra == "keep" else ():
        if name == "normals":
            kept |= {f"n{axis}": arrays[name][:, i] for i, axis in enumerate("xyz")}
        else:
            kept[name] = _column(name, arrays[name])
    scene = Scene(**planes, has_normals=zero_normals, extra=kept)
    return scene if exact else with_finite_ends(scene)


def turn_cloud(cloud: open3d.t.geometry.PointCloud, system: str) -> open3d.t.geometry.PointCloud:
    """A copy of a cloud whose file did not state its `system`, converted to ``RDF``.

    Raises like `from_cloud` and `turn_axes`.
    """
    return to_cloud(state_system(from_cloud(cloud, "keep"), system))


def _exponential(log_scale: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        return np.exp(log_scale)


def _check_scales(linear: NDArray[np.float32], log_scale: NDArray[np.float32]) -> None:
    """Reject planes ``(3, N)`` if only one was edited; allow for different rounding of exp."""
    if linear.shape != log_scale.shape:
        raise InvalidInput(
            f"scale: {counted(linear.shape[1], 'row')}, expected {log_scale.shape[1]:,}"
        )
    expected, tiny = _exponential(log_scale), np.finfo(np.float32).tiny
    unlike = (linear != expected).any(axis=0)
    pair = linear[:, unlike], expected[:, unlike]
    count = np.count_nonzero(~np.isclose(*pair, 2e-6, tiny, equal_nan=True).all(axis=0))
    if count:
        raise InvalidInput(
            f"scale: not the exponential of log_scale in {counted(count, 'Gaussian')}; "
            "delete the one that was not edited, after Open3D's scale del cloud.point['log_scale']"
        )


def _plane(arrays: dict[str, NDArray], name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
    if name not in arrays:
        raise InvalidInput(f"attribute '{name}': missing")
    array = arrays[name]
    if array.dtype != np.float32 or array.shape[1:] != shape:
        raise InvalidInput(f"{name}: {array.dtype} {array.shape}, expected float32 (N, {shape[0]})")
    return np.ascontiguousarray(array.T)


def _column(name: str, array: NDArray) -> NDArray:
    if array.ndim != 2 or array.shape[1] != 1:
        raise InvalidInput(f"{name}: shape {array.shape}, expected (N, 1)")
    return array[:, 0]
