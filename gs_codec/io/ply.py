"""INRIA-layout PLY files, read through plyfile and written in the trainer's property order."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Literal

import numpy as np
import plyfile
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, one_line
from gs_codec.io.atomic import atomic_writer
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene
from gs_codec.transform.planar import to_planes, to_rows

log = logging.getLogger(__name__)

_NORMALS = ("nx", "ny", "nz")


def _group_names(coefficients: int) -> dict[str, list[str]]:
    """Property names of each group, for a number of SH-AC coefficients a colour."""
    return {
        "positions": ["x", "y", "z"],
        "f_dc": [f"f_dc_{i}" for i in range(3)],
        "f_rest": [f"f_rest_{i}" for i in range(3 * coefficients)],
        "opacity": ["opacity"],
        "log_scale": [f"scale_{i}" for i in range(3)],
        "rot": [f"rot_{i}" for i in range(4)],
    }


def read_ply(path: str | Path, extra: Literal["error", "keep", "drop"] = "error") -> Scene:
    """Read a 3DGS scene from a PLY file (binary of either endianness, or ASCII).

    Parameters
    ----------
    path : str or Path
    extra : {"error", "keep", "drop"}
        What to do with properties beyond the INRIA layout and normals that are not all zero.

    Returns
    -------
    Scene

    Raises
    ------
    InvalidInput
        If the file is not a PLY, is truncated, or lacks or adds properties.
    """
    vertex, comments = _open_vertices(Path(path))
    data = vertex.data
    for prop in vertex.properties:
        if isinstance(prop, plyfile.PlyListProperty):
            raise InvalidInput(f"{path}: property '{prop.name}' is a list, expected a scalar")
    groups = _find_groups(path, data.dtype.names)
    wanted = [name for group in GROUPS for name in groups[group]]
    planes = _read_planes(path, data, wanted)
    bounds = np.cumsum([0] + [len(groups[group]) for group in GROUPS])
    parts = {g: planes[a:b] for g, a, b in zip(GROUPS, bounds[:-1], bounds[1:], strict=True)}
    has_normals, kept = _read_rest(path, data, set(wanted), extra)
    return Scene(**parts, has_normals=has_normals, comments=comments, extra=kept)


def _open_vertices(path: Path) -> tuple[plyfile.PlyElement, tuple[str, ...]]:
    if os.path.isdir(path):
        raise InvalidInput(f"{path}: a directory, expected a PLY file")
    try:
        ply = plyfile.PlyData.read(path, mmap="r")
    except plyfile.PlyParseError as error:
        raise InvalidInput(f"{path}: not a readable PLY file ({one_line(error)})") from error
    except MemoryError as error:
        raise InvalidInput(f"{path}: more Gaussians than memory can hold") from error
    except UnicodeDecodeError as error:
        raise InvalidInput(
            f"{path}: not a readable PLY file (its header is not ASCII text)"
        ) from error
    except (ValueError, OverflowError) as error:
        raise InvalidInput(f"{path}: not a readable PLY file ({one_line(error)})") from error
    except OSError as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from error
    names = [element.name for element in ply.elements]
    if names != ["vertex"]:
        found = ", ".join(f"'{name}'" for name in names) or "none"
        raise InvalidInput(f"{path}: elements {found}, expected 'vertex' alone")
    vertex = ply["vertex"]
    if ply.obj_info:
        log.warning("%s: %d obj_info lines not kept", path, len(ply.obj_info))
    # Data that is mapped knows where it begins; without Gaussians nothing is.
    size = path.stat().st_size
    surplus = size - getattr(vertex.data, "offset", size) - vertex.data.nbytes
    if not ply.text and surplus > 0:
        log.warning("%s: %d bytes after the last vertex not read", path, surplus)
    return vertex, (*ply.comments, *vertex.comments)


def _find_groups(path: str | Path, names: tuple[str, ...]) -> dict[str, list[str]]:
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in [3 * k for k in SH_COEFFICIENTS]:
        raise InvalidInput(f"{path}: {rest} f_rest properties, expected 0, 9, 24 or 45")
    groups = _group_names(rest // 3)
    missing = [n for group in GROUPS for n in groups[group] if n not in names]
    if missing:
        raise InvalidInput(f"{path}: missing property '{missing[0]}' ({len(missing)} missing)")
    return groups


def _read_planes(path: str | Path, data: NDArray, wanted: list[str]) -> NDArray[np.float32]:
    """Planes of the wanted properties, straight from the mapped rows where all are float32."""
    names = list(data.dtype.names or ())
    packed = data.dtype.itemsize == 4 * len(names)
    if packed and all(data.dtype[name] == np.dtype("<f4") for name in names):
        rows = np.ascontiguousarray(data).view("<f4").reshape(len(data), len(names))
        return to_planes(rows, [names.index(name) for name in wanted])
    planes = np.empty((len(wanted), len(data)), np.float32)
    for plane, name in zip(planes, wanted, strict=True):
        with np.errstate(over="ignore"):
            plane[:] = data[name]
        changed = int(np.count_nonzero((plane != data[name]) & (data[name] == data[name])))
        if changed:
            log.warning("%s: %s rounded to float32 in %d Gaussians", path, name, changed)
    return planes


def _read_rest(
    path: str | Path, data: NDArray, used: set[str], extra: str
) -> tuple[bool, dict[str, NDArray]]:
    """Whether there are (all-zero) normals, and the properties to keep beside them."""
    rest = [name for name in data.dtype.names or () if name not in used]
    normals = [name for name in _NORMALS if name in rest]
    has_normals = len(normals) == 3
    # Zeros are written back as +0: who asks to keep what is there may have others.
    differs = np.signbit if extra == "keep" else np.zeros_like
    if has_normals and not any(np.any(data[n]) or np.any(differs(data[n])) for n in normals):
        rest = [name for name in rest if name not in normals]
    if rest and extra == "error":
        what = f"properties {', '.join(rest[:4])}" + (" ..." if len(rest) > 4 else "")
        why = "normals are not all zero" if set(rest) <= set(_NORMALS) else "beyond the layout"
        raise InvalidInput(f"{path}: {what} ({why}); choose --extra keep or --extra drop")
    if extra == "drop":
        return has_normals, {}
    kept = {name: np.array(data[name], data.dtype[name].newbyteorder("=")) for name in rest}
    return has_normals and not set(normals) & set(rest), kept


def write_ply(path: str | Path, scene: Scene) -> None:
    """Write `scene` as little-endian binary PLY in the INRIA trainer's property order.

    Raises
    ------
    InvalidInput
        If the file cannot be written.
    """
    element = plyfile.PlyElement.describe(vertex_rows(scene), "vertex")
    ply = plyfile.PlyData([element], byte_order="<", comments=list(scene.comments))
    with atomic_writer(path) as file:
        ply.write(file)


def vertex_rows(scene: Scene) -> NDArray:
    """Structured rows ``(N,)`` in the trainer's order; extra properties come last."""
    groups = _group_names(len(scene.f_rest) // 3)
    names, planes = [], []
    for group in GROUPS:
        names += groups[group]
        planes += [*getattr(scene, group)]
        if group == "positions" and scene.has_normals:
            names += _NORMALS
            planes += [np.zeros(scene.count, np.float32)] * 3
    rows = to_rows(planes).view([(name, "<f4") for name in names])[:, 0]
    if not scene.extra:
        return rows
    dtype = np.dtype(rows.dtype.descr + [(n, a.dtype.str) for n, a in scene.extra.items()])
    full = np.empty(scene.count, dtype)
    for name in names:
        full[name] = rows[name]
    for name, column in scene.extra.items():
        full[name] = column
    return full
