"""Checkpoints of gsplat (``.pt``), splatfacto (``.ckpt``) and INRIA's trainer (``.pth``).

A file is a zip of a pickle, which describes the content, and of an entry with each tensor's values.
Nothing named in the pickle is executed.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping, Sized
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import CHECKPOINT
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.limits import check_count, most_bytes, refusing
from gs_codec.formats.pickled import StoredTensor, parse_pickle, write_pickle
from gs_codec.formats.ply.dialects import say_flat, with_flat
from gs_codec.formats.tensors import (
    NAMES,
    NERFSTUDIO,
    check_shapes,
    scene_of_tensors,
    tensors_of,
)
from gs_codec.formats.zip_file import Archive, only_scene, opened_zip, write_zip
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.runtime.wording import counted
from gs_codec.scene import ANTIALIASED, FLAT, SH_COEFFICIENTS, Scene

log = logging.getLogger(__name__)

PICKLE = "data.pkl"

#: Maximum bytes of a pickle; those of trainers have a few thousand.
_PICKLE_BYTES = 1 << 22

#: Types of the values of a storage. BFloat16 is the upper half of a float32.
_TYPES = {
    "torch FloatStorage": "<f4",
    "torch HalfStorage": "<f2",
    "torch DoubleStorage": "<f8",
    "torch BFloat16Storage": "<u2",
}
_FLOAT = "torch FloatStorage"

#: Entries of a checkpoint begin at multiples of this offset, as in PyTorch's files.
_MULTIPLE = 64

#: Tensors of INRIA's trainer, after the SH degree; `opacities` are a column.
_CAPTURED = ("means", "sh0", "shN", "scales", "quats", "opacities")

#: Folders of checkpoints of nerfstudio and gsplat, and configurations in the folders above them.
_CONFIGURATIONS = {"nerfstudio_models": ("config.yml",), "ckpts": ("cfg.yml", "cfg.json")}

#: Maximum bytes of a configuration; those of trainers have a few thousand.
_CONFIGURATION_BYTES = 1 << 20

#: Settings of scenes with opacity compensation, and of 2D Gaussians, in YAML or JSON.
_COMPENSATED = re.compile(rb'\b(?:rasterize_mode"?: "?antialiased|antialiased"?: true)\b')
_SURFELS = re.compile(rb'\bmodel_type"?: "?2dgs\b')

#: Prefix of splatfacto's tensor names.
_MODEL = "_model.gauss_params."


def is_checkpoint(path: Path, data: FileBytes) -> bool:
    """Whether the first entry of a zip file is the pickle of a checkpoint."""
    name = bytes(data[30 : 30 + int.from_bytes(data[26:28], "little")])
    return name.rpartition(b"/")[2] == PICKLE.encode()


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Archive, str, dict[str, StoredTensor]]]:
    """Open the zip; yield its folder, and the tensors of Gaussians by name."""
    with located(path), opened_zip(path) as archive:
        name = only_scene(archive.named(PICKLE), f"{PICKLE}, expected a checkpoint of PyTorch")
        folder = name.removesuffix(PICKLE)
        if f"{folder}byteorder" in archive.names:
            order = archive.read(f"{folder}byteorder", 16)
            if order != b"little":
                raise InvalidInput(f"byte order {order!a}, expected b'little'")
        if any(each.startswith(f"{folder}code/") for each in archive.names):
            raise InvalidInput("a network of TorchScript (as of Scaffold-GS), not Gaussians")
        yield archive, folder, _splats(parse_pickle(archive.read(name, _PICKLE_BYTES)))


def _splats(root: Any) -> dict[str, StoredTensor]:
    """Tensors by name, from the first dictionary with ``means``; prefixes are ignored.

    INRIA's trainer and trainers built on it (``chkpnt30000.pth``) have a tuple of tensors in it.
    """
    state = root[0] if isinstance(root, tuple) and root else ()
    captured = state[1:7] if isinstance(state, tuple) else ()
    if len(captured) == 6 and all(isinstance(each, StoredTensor) for each in captured):
        return dict(zip(_CAPTURED, captured, strict=True))
    outer = [root, *root.values()] if isinstance(root, dict) else []
    # Each dictionary once, because a hostile file may contain one a million times.
    for state in {id(state): state for state in outer if isinstance(state, dict)}.values():
        tensors = {str(k): value for k, value in state.items() if isinstance(value, StoredTensor)}
        for name in tensors:
            before, dot, last = name.rpartition(".")
            if last == "means":
                known = (*NAMES, *NERFSTUDIO)
                return {n: tensors[before + dot + n] for n in known if before + dot + n in tensors}
    raise InvalidInput(
        "a checkpoint of PyTorch without 'means', expected one of gsplat, splatfacto or INRIA's "
        "trainer"
    )


def stated_size(path: Path, data: Sized) -> tuple[int, int]:
    """Number of Gaussians and SH degree of a checkpoint, from its header."""
    with _opened(path) as (_, _, tensors):
        return check_shapes(tensors)


def read_checkpoint(path: Path, data: Sized, max_bytes: int | None) -> Scene:
    """Read the bytes of a checkpoint; see `SceneFile.scene`."""
    with _opened(path) as (archive, folder, tensors):
        check_count(*check_shapes(tensors), len(data), max_bytes)
        most = most_bytes(len(data), max_bytes)
        arrays = {n: _numbers(archive, folder, tensors[n], most) for n in tensors}
        scene = _as_configured(path, scene_of_tensors(arrays, path))
    rank = re.compile(r"_rank(\d+)\.")
    other = path.with_name(rank.sub(lambda m: f"_rank{int(m[1] == '0')}.", path.name))
    if other != path and other.exists():
        log.warning(
            "%s: one of several files; others, such as %s, contain the rest of the scene",
            path,
            other.name,
        )
    return scene


def _as_configured(path: Path, scene: Scene) -> Scene:
    """The scene of a checkpoint, with what only the configuration of its run states."""
    folder, text = path.absolute().parent, b""
    for name in _CONFIGURATIONS.get(folder.name, ()):
        with suppress(OSError), open(folder.parent / name, "rb") as file:
            text += file.read(_CONFIGURATION_BYTES)
    if _SURFELS.search(text):
        say_flat(path)
        return replace(scene, log_scale=with_flat(scene.log_scale[:2]), comments=(FLAT,))
    return replace(scene, comments=(ANTIALIASED,)) if _COMPENSATED.search(text) else scene


def _numbers(archive: Archive, folder: str, tensor: StoredTensor, most: int) -> NDArray[np.float32]:
    """Values of a tensor, copied, because its storage may be larger."""
    if tensor.kind not in _TYPES:
        raise InvalidInput(f"tensor of {tensor.kind!a:.40}, expected floats")
    dtype, where = np.dtype(_TYPES[tensor.kind]), f"storage {tensor.key[:20]!a}"
    entry = f"{folder}data/{tensor.key}"
    size = archive.size(entry)
    if size != tensor.length * dtype.itemsize:
        raise InvalidInput(f"{where}: {counted(size, 'byte')} of {tensor.length:,}")
    first, end = tensor.used
    if end > tensor.length or (end - first) * dtype.itemsize > most:
        raise InvalidInput(f"{where}: numbers {first} to {end} of {tensor.length}, too many")
    data = archive.read_part(entry, first * dtype.itemsize, end * dtype.itemsize)
    strides = tuple(dtype.itemsize * stride for stride in tensor.strides)
    with refusing(where):
        array = np.ndarray(tensor.shape, dtype, data, 0, strides)
    if dtype.kind == "u":
        return (array.astype("<u4") << 16).view("<f4")
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def write_checkpoint(path: str | Path, scene: Scene) -> tuple[str, ...]:
    """Write a checkpoint of gsplat or, for ``.ckpt``, of splatfacto, with SH degree 3.

    Returns
    -------
    tuple of str
        Sentences on what it cannot represent.
    """
    arrays, of_model = tensors_of(scene), Path(path).suffix.lower() == ".ckpt"
    if of_model:
        arrays = _splatfacto(arrays)
    tensors: dict[str, StoredTensor] = {}
    entries: dict[str, bytes | memoryview] = {}
    for number, (name, array) in enumerate(arrays.items()):
        strides = tuple(stride // array.itemsize for stride in array.strides)
        tensors[name] = StoredTensor(_FLOAT, str(number), array.size, 0, array.shape, strides)
        entries[f"archive/data/{number}"] = array.reshape(-1).view(np.uint8).data
    root: dict[str, Any] = {"step": 0, "pipeline" if of_model else "splats": tensors}
    if of_model:
        root |= {"optimizers": {}, "schedulers": {}, "scalers": {}}
    head: dict[str, bytes | memoryview] = {
        f"archive/{PICKLE}": write_pickle(root),
        "archive/byteorder": b"little",
        "archive/version": b"3\n",
    }
    with atomic_writer(path) as file:
        write_zip(file, head | entries, _MULTIPLE)
    return tuple(left_out_of(scene, CHECKPOINT))


def _splatfacto(arrays: Mapping[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
    """The arrays with splatfacto's names; its models have SH degree 3 by default."""
    missing = SH_COEFFICIENTS[-1] - arrays["shN"].shape[1]
    changed = {
        "opacities": arrays["opacities"][:, None],
        "sh0": arrays["sh0"][:, 0],
        "shN": np.pad(arrays["shN"], ((0, 0), (0, missing), (0, 0))),
    }
    names = {ours: name for name, ours in NERFSTUDIO.items()}
    return {f"{_MODEL}{names.get(n, n)}": array for n, array in {**arrays, **changed}.items()}
