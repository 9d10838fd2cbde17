"""Convert point clouds from and to the tensors of trainers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import with_finite_ends
from gs_codec.config import Option
from gs_codec.errors import InvalidInput
from gs_codec.formats.cloud import from_cloud, to_cloud
from gs_codec.formats.limits import refusing
from gs_codec.formats.tensors import scene_of_tensors, tensors_of
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.optional import needed
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud
    from torch import Tensor


def from_tensors(tensors: Mapping[str, Any]) -> PointCloud:
    """Make a cloud from the tensors that a trainer optimises, before activation.

    Parameters
    ----------
    tensors : mapping of str to array or tensor
        NumPy or torch floats on any device; they are copied and converted to float32. Names and
        shapes are gsplat's: ``means (N, 3)``, ``quats (N, 4)`` (wxyz, of any norm), ``scales (N,
        3)`` (natural logarithm), ``opacities (N,)`` or ``(N, 1)`` (logit), ``sh0 (N, 1, 3)`` or
        ``(N, 3)``, ``shN (N, K, 3)`` with K = 0, 3, 8, 15, or none. nerfstudio's names of the last
        two, ``features_dc`` and ``features_rest``, are accepted; with K = 0 they are colours before
        the sigmoid.

    Returns
    -------
    open3d.t.geometry.PointCloud
        A cloud with the attributes from `read`. Coordinates are assumed to be right, down, forward,
        as in the PLY files of these trainers.

    Raises
    ------
    InvalidInput
        If a tensor is missing or unknown, has another shape, or does not contain floats.
    MissingTool
        If Open3D is not installed.

    Examples
    --------
    In a trainer, ``splats`` is its `ParameterDict`:

    >>> splats = gs_codec.to_tensors(gs_codec.read("scene.ply"), "torch")
    >>> data = gs_codec.encode(gs_codec.from_tensors(splats), gs_codec.Config("s"))
    >>> len(data) < 60_000
    True
    """
    return to_cloud(scene_of_trainer(tensors))


def scene_of_trainer(tensors: Mapping[str, Any]) -> Scene:
    """The scene of a trainer's tensors; parameters and errors as in `from_tensors`."""
    if not hasattr(tensors, "items"):  # torch's ParameterDict is not a Mapping
        given = type(tensors).__name__
        raise InvalidInput(f"tensors: {given}, expected a mapping of names to tensors")
    return with_finite_ends(
        scene_of_tensors({name: array_of(each) for name, each in tensors.items()})
    )


@overload
def to_tensors(
    cloud: PointCloud, library: Literal["numpy"] = "numpy"
) -> dict[str, NDArray[np.float32]]: ...


@overload
def to_tensors(cloud: PointCloud, library: Literal["torch"]) -> dict[str, Tensor]: ...


@checked
def to_tensors(
    cloud: PointCloud, library: Literal["numpy", "torch"] = "numpy"
) -> dict[str, NDArray[np.float32]] | dict[str, Tensor]:
    """The tensors of a cloud, with the names and shapes of gsplat's trainer, before activation.

    Parameters
    ----------
    cloud : open3d.t.geometry.PointCloud
        A cloud with the attributes from `read`; others are dropped.
    library : {"numpy", "torch"}
        Arrays, or tensors on the CPU. They share no memory with the cloud.

    Returns
    -------
    dict of str to ndarray or Tensor
        Float32 ``means (N, 3)``, ``quats (N, 4)`` (wxyz as stored), ``scales (N, 3)`` (natural
        logarithm), ``opacities (N,)`` (logit), ``sh0 (N, 1, 3)``, ``shN (N, K, 3)``.

    Raises
    ------
    InvalidInput
        If the cloud lacks an attribute, or `library` is unknown.
    MissingTool
        If torch is requested and not installed.

    Examples
    --------
    >>> tensors = gs_codec.to_tensors(gs_codec.read("scene.ply"))
    >>> tensors["means"].shape, tensors["opacities"].shape, tensors["shN"].shape
    ((2000, 3), (2000,), (2000, 15, 3))
    """
    Option("", values=("numpy", "torch")).check("library", library)
    tensors = tensors_of(from_cloud(cloud, "drop"))
    if library == "numpy":
        return tensors
    torch = needed("torch", "to_tensors")
    return {name: torch.from_numpy(array) for name, array in tensors.items()}


def array_of(value: Any) -> NDArray:
    """Convert a NumPy array-like or a tensor to an array; NumPy lacks some tensor types.

    Raises InvalidInput if that is not possible.
    """
    with refusing("tensor"):
        if hasattr(value, "detach"):
            value = value.detach().cpu()
            value = (value.float() if value.is_floating_point() else value).numpy(force=True)
        return np.asarray(value)
