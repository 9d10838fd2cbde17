"""Select Gaussians by position and by attributes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.matching import without_order
from gs_codec.coding.clean import sound_gaussians
from gs_codec.coding.morton import spatial_order
from gs_codec.edit.actions import COMPARED, read_condition
from gs_codec.edit.clouds import on_clouds
from gs_codec.errors import InvalidInput
from gs_codec.formats.packed_values import sigmoid, spans
from gs_codec.runtime.arrays import empty, finite
from gs_codec.scene import GROUPS, SH_C0, SH_COEFFICIENTS, Scene, property_names


@on_clouds
def crop_box(scene: Scene, low: Sequence[float], high: Sequence[float]) -> Scene:
    """Keep the Gaussians whose centres are in a box, including its faces.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    low, high : sequence of three float
        Corners of the box, scene units.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The remaining Gaussians, in their original order, with all attributes.

    Raises
    ------
    InvalidInput
        If a corner is not finite, or the lower one above the other.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> half = gs_codec.edit.crop_box(cloud, (-100, -100, 0), (100, 100, 100))
    """
    return _keep(scene, in_box(scene, low, high))


def in_box(scene: Scene, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `crop_box` keeps."""
    lowest, highest = finite("low", low, 3), finite("high", high, 3)
    if (lowest > highest).any():
        raise InvalidInput("high: below low on an axis, expected the lowest corner first")

    def inside(some: Scene) -> NDArray[np.bool_]:
        centres = some.positions.T
        return ((centres >= lowest) & (centres <= highest)).all(axis=1)

    return _mask(scene, inside)


@on_clouds
def crop_sphere(scene: Scene, centre: Sequence[float], radius: float) -> Scene:
    """Keep the Gaussians whose centres are in a sphere, including its surface.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    centre : sequence of three float
        Scene units.
    radius : float
        Scene units, above 0.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The remaining Gaussians, in their original order, with all attributes.

    Raises
    ------
    InvalidInput
        If a number is not finite, or the radius is not above 0.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> near = gs_codec.edit.crop_sphere(cloud, (0, 0, 0), 2.5)
    """
    return _keep(scene, in_sphere(scene, centre, radius))


def in_sphere(scene: Scene, centre: Sequence[float], radius: float) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `crop_sphere` keeps."""
    middle, limit = finite("centre", centre, 3), finite("radius", [radius], 1)[0]
    if limit <= 0:
        raise InvalidInput(f"radius {radius}: expected a number above 0")

    def inside(some: Scene) -> NDArray[np.bool_]:
        return np.linalg.norm(some.positions.T - middle, axis=1) <= limit

    return _mask(scene, inside)


@on_clouds
def select(scene: Scene, condition: str) -> Scene:
    """Keep the Gaussians that satisfy a condition; NaN satisfies none.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    condition : str
        An attribute, one of ``< <= > >= == !=``, and a number: ``opacity>0.05``. Attributes are ``x
        y z`` (scene units), ``opacity`` (0-1), ``scale_0`` to ``scale_2`` and, of each Gaussian's
        three, ``longest_scale``, ``middle_scale`` and ``shortest_scale`` (standard deviations,
        scene units), ``red green blue`` (colours of SH-DC, 0-1), ``f_dc_0`` to ``f_dc_2`` and
        ``f_rest_0`` to ``f_rest_44`` (SH), ``rot_0`` to ``rot_3`` (wxyz as stored), and extra
        properties by name.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The remaining Gaussians, in their original order, with all attributes.

    Raises
    ------
    InvalidInput
        If the condition is not of this form, or the scene has no such attribute.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> visible = gs_codec.edit.select(cloud, "opacity>0.05")
    >>> len(visible.point.positions) < len(cloud.point.positions)
    True
    """
    return select_where(scene, *read_condition(condition))


def select_where(scene: Scene, name: str, compared: str, number: float) -> Scene:
    """Like `select`, with a parsed condition."""
    if name not in (known := attribute_names(scene)):
        listed = ", ".join(known[:24]) + (", ..." if len(known) > 24 else "")
        raise InvalidInput(f"no attribute '{name}', expected one of {listed}")

    def holds(some: Scene) -> NDArray[np.bool_]:
        values = attribute_values(some, name)
        return COMPARED[compared](values, number) & ~np.isnan(values)

    return _keep(scene, _mask(scene, holds))


@on_clouds
def remove_nonfinite(scene: Scene) -> Scene:
    """Remove the Gaussians with NaN or infinity.

    Infinite opacity logits (opacity 0 or 1) and scales of 0 are valid and kept.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The remaining Gaussians, in their original order, with all attributes.

    Raises
    ------
    InvalidInput
        If the cloud lacks an attribute of a scene.

    Examples
    --------
    >>> cloud = gs_codec.edit.remove_nonfinite(gs_codec.read("scene.ply"))
    """
    return _keep(scene, _mask(scene, sound_gaussians))


@on_clouds
def limit_sh_degree(scene: Scene, sh_degree: int) -> Scene:
    """Drop the SH above a degree.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    sh_degree : int
        0 to 3; a scene of a lower degree does not change.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The scene with the remaining SH.

    Raises
    ------
    InvalidInput
        If the degree is not 0 to 3.

    Examples
    --------
    >>> cloud = gs_codec.edit.limit_sh_degree(gs_codec.read("scene.ply"), 1)
    >>> cloud.point.f_rest.shape
    SizeVector[2000, 3, 3]
    """
    if sh_degree not in range(len(SH_COEFFICIENTS)):
        raise InvalidInput(f"sh_degree {sh_degree}: expected 0 to 3")
    if sh_degree >= scene.sh_degree:
        return scene
    each, kept = len(scene.f_rest) // 3, SH_COEFFICIENTS[int(sh_degree)]
    rest = empty((3 * kept, scene.count), np.float32)
    for colour in range(3):
        rest[colour * kept : (colour + 1) * kept] = scene.f_rest[colour * each :][:kept]
    return replace(scene, f_rest=rest)


@on_clouds
def sort_morton(scene: Scene) -> Scene:
    """Sort Gaussians by the Morton code of their centres, so that neighbours are near in the file.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`; its centres are finite.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The same Gaussians in this order.

    Raises
    ------
    InvalidInput
        If a centre is not finite.

    Examples
    --------
    >>> cloud = gs_codec.edit.sort_morton(gs_codec.read("scene.ply"))
    """
    if not np.isfinite(scene.positions).all():
        raise InvalidInput('centres that are not finite, expected Action("remove-nan") before')
    return without_order(scene.take(spatial_order(scene.positions, scene.log_scale)))


def attribute_names(scene: Scene) -> list[str]:
    """Names of a scene's attributes that `attribute_values` accepts."""
    names = property_names(len(scene.f_rest) // 3)
    stored = [name for group in GROUPS if group != "f_rest" for name in names[group]]
    return [*stored, *_DERIVED, *scene.extra, *names["f_rest"]]


def attribute_values(scene: Scene, name: str) -> NDArray:
    """Values ``(N,)`` of an attribute in its natural unit; see `select`."""
    if name in scene.extra:
        return scene.extra[name]
    if name in _DERIVED:
        return _DERIVED[name](scene)
    names = property_names(len(scene.f_rest) // 3)
    group = next(group for group in GROUPS if name in names[group])
    plane = getattr(scene, group)[names[group].index(name)].astype(np.float64)
    if group == "opacity":
        return sigmoid(plane)
    with np.errstate(over="ignore"):
        return np.exp(plane) if group == "log_scale" else plane


def _scale(scene: Scene, rank: int) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):
        return np.exp(np.sort(scene.log_scale, axis=0)[rank].astype(np.float64))


def _colour(scene: Scene, channel: int) -> NDArray[np.float64]:
    return 0.5 + SH_C0 * scene.f_dc[channel].astype(np.float64)


#: Attributes that are computed from stored ones.
_DERIVED: Mapping[str, Callable[[Scene], NDArray]] = {
    "longest_scale": lambda scene: _scale(scene, 2),
    "middle_scale": lambda scene: _scale(scene, 1),
    "shortest_scale": lambda scene: _scale(scene, 0),
    "red": lambda scene: _colour(scene, 0),
    "green": lambda scene: _colour(scene, 1),
    "blue": lambda scene: _colour(scene, 2),
}


def _mask(scene: Scene, chosen: Callable[[Scene], NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Mask ``(N,)`` of the chosen Gaussians, computed part by part."""
    mask = np.empty(scene.count, bool)
    for some in spans(scene.count):
        mask[some] = chosen(scene.between(some.start, some.stop))
    return mask


def _keep(scene: Scene, mask: NDArray[np.bool_]) -> Scene:
    """The Gaussians of a mask, in their order; the scene itself if the mask selects all."""
    return scene if mask.all() else without_order(scene.take(mask))
