"""A 3DGS scene in memory: planar float32 arrays, one row per channel."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.runtime.wording import counted

#: Number of SH-AC coefficients per colour, for each SH degree.
SH_COEFFICIENTS = (0, 3, 8, 15)

#: Number of coefficients of degree 4, which some programs write and we discard.
DEGREE_4 = 24

#: Attribute groups of a scene, in the order reports list them.
GROUPS = ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot")

#: Value of the SH basis function of degree 0: a colour is 0.5 + SH_C0 * f_dc.
SH_C0 = 0.28209479177387814

#: Factors of the SH basis functions of degrees 1, 2 and 3.
SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)

#: Valid names of extra properties: printable, without spaces; `_TYPES` has the types.
_NAME = re.compile("[!-~]{1,255}")
_LAYOUT = re.compile(r"[xyz]|f_dc_[012]|f_rest_\d+|opacity|scale_[012]|rot_[0123]")
_RENDER_MODE = re.compile(r"\s*(?:SplatRenderMode:|antialiased\s)\s*(\w+)\s*", re.IGNORECASE)
_COORDINATES = re.compile(
    r"\s*CoordinateSystem:\s*([LR](?:[UD][FB]|[FB][UD]))\s*", re.ASCII | re.IGNORECASE
)

_OFFSET = re.compile(r"\s*CoordinateOffset:\s*(\S+)\s+(\S+)\s+(\S+)\s*", re.IGNORECASE)

#: Translation of centres, x, y, z.
Shift = tuple[float, float, float]

Integer = TypeVar("Integer", bound=np.integer)

#: Extra properties that are rotated with the Gaussians.
NORMALS = ("nx", "ny", "nz")

#: PLY comment of a scene that was trained with opacity compensation.
ANTIALIASED = "SplatRenderMode: mip"

#: Start of the PLY comment that states the order of a decoded scene's Gaussians.
ORDER = "gs_codec order "

#: PLY comment of a scene of flat Gaussians (2DGS), as of splat-transform.
FLAT = "SplatRenderMode: 2dgs"
_TYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")


def sh_bands(coefficients: int = SH_COEFFICIENTS[-1]) -> list[range]:
    """SH-AC coefficient indices of each band, for this many coefficients per colour."""
    edges = [edge for edge in SH_COEFFICIENTS if edge <= coefficients]
    return [range(first, last) for first, last in pairwise(edges)]


def sh_values(x, y, z, coefficients, basis):
    """Fill ``basis (15, ...)`` with the first `coefficients` SH-AC values in a unit direction.

    Kernels compile this function; x, y and z may also be arrays.
    """
    if coefficients >= 3:
        basis[0] = -SH_C1 * y
        basis[1] = SH_C1 * z
        basis[2] = -SH_C1 * x
    if coefficients >= 8:
        basis[3] = SH_C2[0] * x * y
        basis[4] = -SH_C2[0] * y * z
        basis[5] = SH_C2[1] * (2.0 * z * z - x * x - y * y)
        basis[6] = -SH_C2[0] * x * z
        basis[7] = SH_C2[2] * (x * x - y * y)
    if coefficients >= 15:
        basis[8] = -SH_C3[0] * y * (3.0 * x * x - y * y)
        basis[9] = SH_C3[1] * x * y * z
        basis[10] = -SH_C3[2] * y * (4.0 * z * z - x * x - y * y)
        basis[11] = SH_C3[3] * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        basis[12] = -SH_C3[2] * x * (4.0 * z * z - x * x - y * y)
        basis[13] = SH_C3[4] * z * (x * x - y * y)
        basis[14] = -SH_C3[0] * x * (x * x - 3.0 * y * y)


def property_names(coefficients: int = SH_COEFFICIENTS[-1]) -> dict[str, list[str]]:
    """Names of the channels of each group as in the PLY, for this many SH-AC per colour."""
    return {
        "positions": ["x", "y", "z"],
        "f_dc": [f"f_dc_{i}" for i in range(3)],
        "f_rest": [f"f_rest_{i}" for i in range(3 * coefficients)],
        "opacity": ["opacity"],
        "log_scale": [f"scale_{i}" for i in range(3)],
        "rot": [f"rot_{i}" for i in range(4)],
    }


def group_rows(coefficients: int) -> dict[str, int]:
    """Number of channels of each group, for this many SH-AC coefficients per colour."""
    return {group: len(names) for group, names in property_names(coefficients).items()}


def channel_count(coefficients: int) -> int:
    """Number of channels of all groups, for this many SH-AC coefficients per colour."""
    return sum(group_rows(coefficients).values())


def float_bytes(count: int, sh_degree: int) -> int:
    """Bytes of the floats of `count` Gaussians."""
    return 4 * count * channel_count(SH_COEFFICIENTS[sh_degree])


def coordinates_comment(system: str) -> str:
    """PLY comment that names the coordinate system of centres and rotations."""
    return f"CoordinateSystem: {system}"


def stated_comments(coordinates: str | None, antialiased: bool) -> tuple[str, ...]:
    """Comments that state a coordinate system, if any, and antialiasing."""
    system = () if coordinates is None else (coordinates_comment(coordinates),)
    return (ANTIALIASED, *system) if antialiased else system


def comment_lines(comments: Iterable[str]) -> list[str]:
    """Split comments into single lines."""
    return [line for comment in comments for line in comment.split("\n")]


def coordinates_of(comments: Iterable[str]) -> str | None:
    """The coordinate system named in comments, as in `Scene.coordinates`."""
    found = [m[1].upper() for m in map(_COORDINATES.fullmatch, comment_lines(comments)) if m]
    return found[-1] if found else None


def antialiased_of(comments: Iterable[str]) -> bool:
    """Whether comments ask for opacity compensation, as in `Scene.antialiased`."""
    return render_mode(comments) in ("mip", "1")


def render_mode(comments: Iterable[str]) -> str:
    """The last render mode in comments, in lower case; empty if there is none."""
    found = [m[1].lower() for m in map(_RENDER_MODE.fullmatch, comment_lines(comments)) if m]
    return found[-1] if found else ""


def offset_of(comments: Iterable[str]) -> Shift | None:
    """Offset from stored centres to source coordinates, from the last comment that states one."""
    found = [m for m in map(_OFFSET.fullmatch, comment_lines(comments)) if m]
    try:
        x, y, z = map(float, found[-1].groups())
    except (IndexError, ValueError):
        return None
    return x, y, z


def with_offset(comments: Iterable[str], offset: Iterable[float] | None) -> tuple[str, ...]:
    """Replace the offset stated in comments, or remove it if None; see `offset_of`."""
    kept = tuple(each for each in comments if not _OFFSET.fullmatch(each))
    if offset is None:
        return kept
    return (*kept, "CoordinateOffset: " + " ".join(f"{float(x)!r}" for x in offset))


def other_comments(comments: Iterable[str]) -> tuple[str, ...]:
    """The comment lines that concern neither the coordinate system nor antialiasing."""
    lines = comment_lines(comments)
    return tuple(
        line for line in lines if not (_COORDINATES.fullmatch(line) or _RENDER_MODE.fullmatch(line))
    )


def is_extra_name(name: str) -> bool:
    """Whether a property beyond the layout may have this name."""
    return bool(_NAME.fullmatch(name)) and not _LAYOUT.fullmatch(name)


@dataclass(frozen=True)
class Scene:
    """Gaussians as planes, in the parameterisation of the INRIA trainer.

    Raises InvalidInput if shapes or dtypes disagree.

    Parameters
    ----------
    positions : ndarray, shape (3, N), float32
        Centres in scene units.
    f_dc : ndarray, shape (3, N), float32
        Degree-0 SH coefficient of R, G, B.
    f_rest : ndarray, shape (3 * K, N), float32
        SH-AC, colour-major as in the PLY: K coefficients of R, then G, then B;
        K = 0, 3, 8, 15 for SH degree 0-3.
    opacity : ndarray, shape (1, N), float32
        Logit of the opacity.
    log_scale : ndarray, shape (3, N), float32
        Natural logarithm of the standard deviation along each axis.
    rot : ndarray, shape (4, N), float32
        Quaternion wxyz as stored, of any norm.
    has_normals : bool
        Whether the file had (all-zero) normals, so that they can be written back.
    comments : tuple of str
        Comment lines of the PLY header.
    extra : mapping of str to ndarray, each shape (N,)
        Further per-Gaussian properties in their own dtype.
    """

    positions: NDArray[np.float32]
    f_dc: NDArray[np.float32]
    f_rest: NDArray[np.float32]
    opacity: NDArray[np.float32]
    log_scale: NDArray[np.float32]
    rot: NDArray[np.float32]
    has_normals: bool = False
    comments: tuple[str, ...] = ()
    extra: Mapping[str, NDArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = group_rows(0) | {"f_rest": len(self.f_rest)}
        for group in GROUPS:
            plane = getattr(self, group)
            if plane.dtype != np.float32 or plane.ndim != 2:
                raise InvalidInput(
                    f"{group}: {plane.dtype} of {counted(plane.ndim, 'dimension')}, "
                    "expected planar float32"
                )
            expected = (rows[group], self.count)
            if plane.shape != expected:
                raise InvalidInput(f"{group}: shape {plane.shape}, expected {expected}")
        if len(self.f_rest) not in [3 * k for k in SH_COEFFICIENTS]:
            raise InvalidInput(
                f"f_rest: {counted(len(self.f_rest), 'channel')}, expected 0, 9, 24 or 45"
            )
        for name, column in self.extra.items():
            if not is_extra_name(name):
                raise InvalidInput(f"property '{name}': not a valid name of an extra property")
            if column.dtype.name not in _TYPES:
                raise InvalidInput(f"property '{name}': {column.dtype} is not a type of PLY")
            if column.shape != (self.count,):
                raise InvalidInput(f"{name}: shape {column.shape}, expected ({self.count},)")

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return self.positions.shape[1]

    @property
    def sh_degree(self) -> int:
        """SH degree, 0-3."""
        return SH_COEFFICIENTS.index(len(self.f_rest) // 3)

    @property
    def antialiased(self) -> bool:
        """Whether the scene was trained with opacity compensation; the last comment on it counts.

        Brush and splat-transform write ``SplatRenderMode: mip``, Postshot ``antialiased 1``.
        """
        return antialiased_of(self.comments)

    @property
    def coordinates(self) -> str | None:
        """Directions of +x, +y, +z (``RDF``: right, down, forward); the last comment on it counts.

        None without such a comment, as in the trainer's PLY. Some formats have a fixed system.
        """
        return coordinates_of(self.comments)

    @property
    def float_bytes(self) -> int:
        """Size of the raw float32 attributes."""
        return float_bytes(self.count, self.sh_degree)

    def take(self, index: NDArray) -> Scene:
        """Gaussians selected by `index` (indices or mask), in that order."""
        changes: dict[str, Any] = {group: gather(getattr(self, group), index) for group in GROUPS}
        changes["extra"] = {
            name: gather(column[None], index)[0] for name, column in self.extra.items()
        }
        return replace(self, **changes)

    def between(self, start: int, stop: int) -> Scene:
        """Gaussians `start` to `stop`, the latter excluded; without copying."""
        changes: dict[str, Any] = {group: getattr(self, group)[:, start:stop] for group in GROUPS}
        changes["extra"] = {name: column[start:stop] for name, column in self.extra.items()}
        return replace(self, **changes)


def join_scenes(parts: Sequence[Scene]) -> Scene:
    """Concatenate scenes; properties other than Gaussians are those of the first.

    The result has the highest SH degree of all parts; missing SH-AC are 0.
    """
    if len(parts) == 1:
        return parts[0]
    rows = group_rows(max(len(part.f_rest) for part in parts) // 3)
    changes: dict[str, Any] = {
        group: _side_by_side([getattr(part, group) for part in parts], rows[group])
        for group in GROUPS
    }
    changes["extra"] = {
        name: np.concatenate([part.extra[name] for part in parts]) for name in parts[0].extra
    }
    return replace(parts[0], **changes, has_normals=all(part.has_normals for part in parts))


def _side_by_side(parts: Sequence[NDArray[np.float32]], rows: int) -> NDArray[np.float32]:
    """Concatenate planes; parts may have fewer SH-AC rows per colour, which are filled with 0."""
    joined = empty((rows, sum(part.shape[1] for part in parts)), np.float32)
    start = 0
    for part in parts:
        stop = start + part.shape[1]
        if len(part) == rows:
            joined[:, start:stop] = part
        else:
            known, each = len(part) // 3, rows // 3
            for colour in range(3):
                own = joined[colour * each : (colour + 1) * each, start:stop]
                own[:known] = part[colour * known : (colour + 1) * known]
                own[known:] = 0
        start = stop
    return joined


def gather(planes: NDArray, index: NDArray) -> NDArray:
    """Columns of ``planes (C, N)`` selected by `index` (indices or mask), in that order."""
    index = np.asarray(index)
    # Convert once instead of per row. Indices are in range, so clipping changes nothing.
    indices = np.flatnonzero(index) if index.dtype == bool else index.astype(np.intp, copy=False)
    gathered = empty((len(planes), len(indices)), planes.dtype)

    def work(row: int) -> None:
        np.take(planes[row], indices, out=gathered[row], mode="clip")

    with using_threads(None, len(indices)):
        run_all(work, range(len(planes)))
    return gathered


def inverse_of(order: NDArray[Integer]) -> NDArray[Integer]:
    """The place of each index in ``order (N,)``, which has every index below N once."""
    places = np.empty_like(order)
    places[order] = np.arange(len(order), dtype=order.dtype)
    return places


def take_columns(planes: NDArray, index: NDArray[np.integer]) -> NDArray:
    """Columns of ``planes (..., N)`` by their indices, like `gather`, on the calling thread."""
    return np.take(planes, index, axis=-1, mode="clip")
