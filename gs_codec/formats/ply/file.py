"""Read PLY files of the INRIA layout, with properties in any order."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Extra
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import CONVENTION, turn_shift
from gs_codec.formats.extra_properties import listed, refuse_beyond, say_degree_4, say_left_out
from gs_codec.formats.limits import check_bytes
from gs_codec.formats.ply.body import Ply, Rows, ply_of
from gs_codec.formats.ply.dialects import (
    FILTER,
    fuse_filter,
    is_flat,
    moving,
    refuse_no_gaussians,
    say_dialect,
    say_halves,
    say_linear,
    with_flat,
    with_model,
)
from gs_codec.formats.ply.packed import PACKED_ELEMENTS, beyond_packed, is_packed, read_packed
from gs_codec.formats.ply.ply_header import PlyHeader
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.mapped import located, opened
from gs_codec.runtime.wording import counted
from gs_codec.scene import (
    DEGREE_4,
    GROUPS,
    NORMALS,
    SH_C0,
    SH_COEFFICIENTS,
    Scene,
    Shift,
    coordinates_of,
    is_extra_name,
    offset_of,
    property_names,
    with_offset,
)

log = logging.getLogger(__name__)

#: Errors of centres below this share of a Gaussian's longest axis need no shift.
_SEEN = 0.01


class Rounding:
    """Fills float32 planes tile by tile, from several threads; logs what was rounded.

    Parameters
    ----------
    names : sequence of str
        Names of the planes; centres come first.
    shift : tuple of three float, optional
        Added to float64 centres before rounding.
    system : str
        Coordinate system of the file.
    """

    def __init__(self, names: Sequence[str], shift: Shift | None, system: str = CONVENTION) -> None:
        self._system = system
        self._names, self._shift = names, shift or (0.0, 0.0, 0.0)
        self._scales = [k for k, name in enumerate(names) if name.startswith("scale_")]
        self._rounded: Counter[str] = Counter()
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._error = self._share = 0.0
        self._lock = Lock()

    def fill(self, planes: Sequence[NDArray[np.float32]], tile: NDArray) -> None:
        """Fill the part of the planes for a tile of rows."""
        for k, (plane, name) in enumerate(zip(planes, self._names, strict=True)):
            with np.errstate(over="ignore", invalid="ignore"):
                plane[:] = self._exact(k, tile)
                if np.can_cast(tile.dtype[name], np.float32):
                    continue
                differs = (plane != self._exact(k, tile)) & np.isfinite(plane)
            with self._lock:
                self._rounded[name] += int(np.count_nonzero(differs))
        if any(self._rounded[name] for name in self._names[:3]):
            self._measure(planes, tile)

    def _exact(self, k: int, tile: NDArray) -> NDArray:
        column = tile[self._names[k]]
        if k < 3 and self._shift[k] and column.dtype.itemsize == 8:
            return column + self._shift[k]
        return column

    def _measure(self, planes: Sequence[NDArray[np.float32]], tile: NDArray) -> None:
        """Largest errors of centres, and the exact bounding box."""
        with np.errstate(all="ignore"):
            exact = np.stack([self._exact(k, tile) for k in range(3)]).astype(np.float64)
            error = np.abs(np.stack(planes[:3]) - exact).max(axis=0)
            longest = np.max([planes[k] for k in self._scales], axis=0).astype(np.float64)
            share = error / np.exp(longest)
        usable = np.isfinite(share)
        if usable.any():
            with self._lock:
                self._error = max(self._error, float(error[usable].max()))
                self._share = max(self._share, float(share[usable].max()))
                self._low = np.minimum(self._low, exact[:, usable].min(axis=1))
                self._high = np.maximum(self._high, exact[:, usable].max(axis=1))

    def tell(self, path: str | Path) -> None:
        """Log what was rounded: one line on centres, and one on everything else."""
        centres = [name for name in self._names[:3] if self._rounded[name]]
        others = [name for name in self._names[3:] if self._rounded[name]]
        if centres:
            log.warning("%s: %s%s", path, self._line(centres), self._how_far())
        if others:
            log.warning("%s: %s", path, self._line(others))

    def _line(self, names: Sequence[str]) -> str:
        most = max(self._rounded[name] for name in names)
        return f"{listed(names)} rounded to float32 in {counted(most, 'Gaussian')}"

    def _how_far(self) -> str:
        text = f", by up to {self._error:.2g} units, {self._share:.2g} times a Gaussian's size"
        if self._share < _SEEN:
            return text
        middle = np.rint((self._low + self._high) / 2)
        x, y, z = -middle
        shift = turn_shift((x, y, z), self._system, CONVENTION)
        by = ",".join(f"{each:.0f}" for each in shift)
        return f'{text}; shift them first: Action("translate", "{by}")'


_COLOURS = ("red", "green", "blue")


def read_ply(path: str | Path, extra: Extra = "keep", max_bytes: int | None = None) -> Scene:
    """Read a 3DGS scene from a PLY file (binary of either endianness, or ASCII).

    The file has the trainer's layout, with properties in any order, or PlayCanvas's packed layout.
    Raises InvalidInput if the file is not a PLY, is truncated, lacks properties, or has properties
    that `extra` rejects.

    Parameters
    ----------
    path : str or Path
    extra : {"keep", "drop", "error"}
        Handling of properties beyond the INRIA layout, of normals that are not all zero, and of
        elements other than ``vertex``. Such elements are never kept. Dropped properties and
        elements are logged.
    max_bytes : int, optional
        Maximum bytes of floats and kept properties; default: see `most_bytes`.
    """
    with opened(path) as data:
        return scene_of(ply_of(path, data), extra, max_bytes)


def scene_of(
    ply: Ply,
    extra: Extra = "keep",
    max_bytes: int | None = None,
    index: slice | NDArray[np.int64] = slice(None),
    tell: bool = True,
    shift: Shift | None = None,
) -> Scene:
    """The scene of an open PLY, or the Gaussians selected by `index`; see `read_ply`.

    Float64 centres are translated by `shift` before rounding; a comment states the offset.

    Dropped properties are logged if `tell`.
    """
    path = ply.path
    with located(path):
        packed = is_packed(ply.header)
        elements = _other_elements(ply, PACKED_ELEMENTS if packed else ("vertex",))
        if packed:
            return _read_packed(ply, elements, extra, max_bytes)
        refuse_no_gaussians(ply.header.elements)
        data = ply.rows("vertex").pick(index)
    groups, colours = _find_groups(path, data.dtype)
    wanted = [name for group in GROUPS for name in groups[group]]
    row = 4 * len(wanted)
    if extra == "keep":
        row += sum(data.dtype[name].itemsize for name in set(data.dtype.names or ()) - {*wanted})
    with located(path):
        check_bytes(len(data) * row, len(data), len(ply.data), max_bytes)
    used = {*wanted}
    others = [n for n in data.dtype.names or () if n not in used and not n.startswith("f_rest_")]
    normals = [*NORMALS] if set(NORMALS) <= set(others) else []
    kept = [n for n in others if n == FILTER or (extra == "keep" and is_extra_name(n))]
    system = coordinates_of(ply.header.comments) or CONVENTION
    rounding = Rounding(wanted, shift, system)
    planes, columns, given = _read_columns(path, data, kept, normals, rounding, len(wanted))
    if not given:
        others = [name for name in others if name not in normals]
        columns = {name: column for name, column in columns.items() if name not in normals}
    if colours:
        planes[3:6] = (planes[3:6] / 255 - 0.5) / SH_C0
    bounds = np.cumsum([0] + [len(groups[group]) for group in GROUPS])
    parts = {g: planes[a:b] for g, a, b in zip(GROUPS, bounds[:-1], bounds[1:], strict=True)}
    if len(groups["log_scale"]) == 2:
        parts["log_scale"] = with_flat(parts["log_scale"])
    if FILTER in others:
        fuse_filter(parts["log_scale"], parts["opacity"], columns.pop(FILTER))
        others.remove(FILTER)
    has_normals = bool(normals) and not set(normals) & set(columns)
    with located(path):
        if extra == "error":
            refuse_beyond(others, elements)
        if tell:
            _say_layout(path, data.dtype)
            say_linear(path, parts["opacity"], parts["log_scale"])
            named = {*columns, *moving(others)}
            left_out = [name for name in others if name not in named]
            say_left_out(path, left_out, elements, _lines(ply.header))
        comments = with_model(ply.header.comments, data.dtype.names or ())
        if shift is not None:
            before = offset_of(comments) or (0.0, 0.0, 0.0)
            comments = with_offset(comments, np.subtract(before, shift))
        return Scene(**parts, has_normals=has_normals, comments=comments, extra=columns)


def _say_layout(path: Path, vertex: np.dtype) -> None:
    """Log how the properties of a vertex are read, where they are unlike INRIA's."""
    names = vertex.names or ()
    say_dialect(path, names)
    say_halves(path, vertex)
    if _rest_of(names) == 3 * DEGREE_4:
        say_degree_4(path)


def _read_packed(ply: Ply, elements: list[str], extra: Extra, max_bytes: int | None) -> Scene:
    """The scene of PlayCanvas's layout; properties beyond it are never kept."""
    properties = beyond_packed(ply.header)
    if extra == "error":
        refuse_beyond(properties, elements)
    say_left_out(ply.path, properties, elements, _lines(ply.header))
    return read_packed(ply, max_bytes)


def _lines(header: PlyHeader) -> dict[str, int]:
    """Number of header lines that are not kept, by kind."""
    return {"obj_info": header.obj_info, "comments that are not ASCII": header.odd_comments}


def _other_elements(ply: Ply, used: tuple[str, ...]) -> list[str]:
    """Elements with rows other than the used ones; rejects a file without Gaussians."""
    if "vertex" not in ply.header.elements:
        names = list(ply.header.elements)
        found = ", ".join(f"'{name[:60]}'" for name in names[:4]) or "none"
        found += ", ..." if len(names) > 4 else ""
        raise InvalidInput(f"elements {found}, expected 'vertex'")
    return [e.name for e in ply.header.elements.values() if e.name not in used and e.count]


def _rest_of(names: Iterable[str]) -> int:
    """Number of properties that are SH-AC."""
    return sum(name.startswith("f_rest_") for name in names)


def _find_groups(path: str | Path, dtype: np.dtype) -> tuple[dict[str, list[str]], bool]:
    """Properties of each group, and whether colours are bytes instead of SH."""
    names = dtype.names or ()
    rest = _rest_of(names)
    if rest not in [3 * k for k in (*SH_COEFFICIENTS, DEGREE_4)]:
        raise InvalidInput(f"{path}: {rest} f_rest properties, expected 0, 9, 24 or 45")
    groups = property_names(min(rest // 3, SH_COEFFICIENTS[-1]))
    if rest == 3 * DEGREE_4:
        kept = [f"f_rest_{c * DEGREE_4 + k}" for c in range(3) for k in range(SH_COEFFICIENTS[-1])]
        groups["f_rest"] = kept
    if is_flat(names):
        groups["log_scale"].remove("scale_2")
    elif not {"scale_1", "scale_2"} & {*names}:  # isotropic, of MonoGS
        groups["log_scale"] = 3 * ["scale_0"]
    # nerfstudio without SH writes colours as bytes.
    colours = "f_dc_0" not in names and all(
        name in names and dtype[name] == np.uint8 for name in _COLOURS
    )
    if colours:
        groups["f_dc"] = list(_COLOURS)
    missing = [n for group in GROUPS for n in groups[group] if n not in names]
    if missing:
        raise InvalidInput(f"{path}: missing property '{missing[0]}' ({len(missing)} missing)")
    return groups, colours


def _read_columns(
    path: str | Path,
    rows: Rows,
    kept: list[str],
    normals: list[str],
    rounding: Rounding,
    number: int,
) -> tuple[NDArray[np.float32], dict[str, NDArray], bool]:
    """Read `number` rounded planes, columns to keep, and whether there are normals, in one pass.

    Normals are written back as +0, so a -0 counts as a normal if it must be kept.
    """
    planes = empty((number, len(rows)), np.float32)
    columns = {name: empty((len(rows),), rows.dtype[name].newbyteorder("=")) for name in kept}
    given: list[bool | np.bool] = []

    def use(place: slice, tile: NDArray) -> None:
        rounding.fill([plane[place] for plane in planes], tile)
        for name, column in columns.items():
            column[place] = tile[name]
        for name in normals:
            with np.errstate(invalid="ignore"):
                other = tile[name].any()
            given.append(other or (name in columns and np.signbit(tile[name]).any()))

    rows.for_tiles(use)
    rounding.tell(path)
    return planes, columns, any(given)
