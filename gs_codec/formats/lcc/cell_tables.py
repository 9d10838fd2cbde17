"""Files next to a `.lcc`: tables of Gaussians by cells of a grid, and levels.

`index.bin` locates the Gaussians of each cell at each level in `data.bin`; `shcoef.bin` has their
SH-AC in the same order, and `environment.bin` distant Gaussians. Centres are float32; other values
are integers between the bounds of the scene.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import LCC
from gs_codec.formats.packed_values import (
    largest_restored,
    log_scales_of,
    opacities_of,
    planes_of,
    sh_of_colours,
)
from gs_codec.runtime.mapped import opened, other_files
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene, join_scenes, stated_comments

_ROW = np.dtype([
    ("centre", "<f4", 3), ("colour", "u1", 4), ("scale", "<u2", 3), ("rot", "<u4"),
    ("normal", "<u2", 3),
])  # fmt: skip
_SH = np.dtype([("sh", "<u4", 15), ("spare", "<u4")])

#: Location of the Gaussians of a cell at a level.
_RUN = [("count", "<u4"), ("offset", "<u8"), ("bytes", "<u4")]

#: First bit and largest value of each colour's SH-AC.
_SH_BITS = ((0, 2047), (11, 1023), (21, 2047))

_MOST_LEVELS = 64


def level_count(value: Any) -> int:
    """A number of levels; `InvalidInput` if it is not valid."""
    if type(value) is not int or not 1 <= value <= _MOST_LEVELS:
        raise InvalidInput(f"levels {value!a:.40}, expected 1 to {_MOST_LEVELS}")
    return value


class Grid:
    """The scene of a `.lcc`; raises `InvalidInput`, or exceptions of `refusing`."""

    def __init__(self, path: Path, about: dict[str, Any]) -> None:
        self.path, attributes = path, {each["name"]: each for each in about["attributes"]}
        kind, self.levels = about.get("fileType"), level_count(about["totalLevel"])
        self.has_sh = kind == "Quality" or (kind != "Portable" and "shcoef" in attributes)
        self.bounds = {
            place + name: _bounds(attributes.get(place + name, attributes[name]))
            for name in (("scale", "shcoef") if self.has_sh else ("scale",))
            for place in ("", "env")
        }
        names = ("index", "data", "environment", *(["shcoef"] if self.has_sh else []))
        self.stated = about["splats"][0]
        self.files = [path.with_name(f"{name}.bin") for name in names]

    def _runs(self) -> NDArray:
        """Location of the Gaussians of each cell at the finest level."""
        cell = np.dtype([("place", "<i2", 2), ("runs", _RUN, (self.levels,))])
        runs = _table(self.files[0], cell)["runs"][:, 0]
        if (total := int(runs["count"].sum())) != self.stated:
            raise InvalidInput(
                f"{self.files[0].name}: {counted(total, 'Gaussian')} at the finest level, "
                f"expected {self.stated!a:.40}"
            )
        return runs

    def _distant(self) -> NDArray:
        """Rows of distant Gaussians, with their SH-AC."""
        kind = np.dtype([*_ROW.descr, *_SH.descr]) if self.has_sh else _ROW
        file = self.files[2]
        return _table(file, kind) if file.is_file() else np.empty(0, kind)

    def stated_size(self) -> tuple[int, int]:
        """Number of Gaussians, and SH degree."""
        self._runs()
        return self.stated + len(self._distant()), 3 * self.has_sh

    def read(self, max_bytes: int | None) -> Scene:
        """Read all Gaussians of the finest level, and the distant ones."""
        runs, distant = self._runs(), self._distant()
        rows = _gathered(self.files[1], runs, _ROW)
        sh = _gathered(self.files[3], runs, _SH) if self.has_sh else rows
        near = self._scene(rows, sh, "")
        return join_scenes([near, self._scene(distant, distant, "env")]) if len(distant) else near

    def _scene(self, rows: NDArray, sh: NDArray, place: str) -> Scene:
        """The Gaussians of rows, with the bounds of this place."""

        def scales(some: slice) -> NDArray:
            low, high = self.bounds[f"{place}scale"][:, :, None]
            share = rows["scale"][some].T / 65535
            return log_scales_of(((1 - share) * low + share * high).astype(np.float32))

        def rotations(some: slice) -> NDArray:
            packed = rows["rot"][some]
            three = np.stack([packed >> shift & 1023 for shift in (0, 10, 20)]) / 1023
            omitted = (packed >> 30).astype(np.int64)
            return largest_restored((2 * three - 1) * np.sqrt(0.5), omitted)[[3, 0, 1, 2]]

        def rest(some: slice) -> NDArray:
            ends = self.bounds[f"{place}shcoef"].T
            shares = [(sh["sh"][some].T >> bit & most) / most for bit, most in _SH_BITS]
            pairs = zip(shares, ends, strict=True)
            return np.concatenate([(1 - each) * low + each * high for each, (low, high) in pairs])

        count = len(rows)
        return Scene(
            np.ascontiguousarray(rows["centre"].T),
            sh_of_colours(rows["colour"].T[:3] / 255),
            planes_of(45, count, rest) if self.has_sh else np.empty((0, count), np.float32),
            opacities_of(self.path, rows["colour"][:, 3]),
            planes_of(3, count, scales),
            planes_of(4, count, rotations),
            comments=stated_comments(LCC.system, False),
        )


def _bounds(attribute: dict[str, Any]) -> NDArray[np.float64]:
    ends = np.array([attribute["min"], attribute["max"]], np.float32)
    if ends.shape != (2, 3) or not np.isfinite(ends).all():
        raise InvalidInput(f"{attribute['name']!a:.40}: expected bounds of three float32 numbers")
    return ends.astype(np.float64)


def _table(path: Path, kind: np.dtype) -> NDArray:
    """All rows of a file."""
    with other_files(), opened(path) as data:
        if len(data) % kind.itemsize:
            raise InvalidInput(
                f"{path}: {counted(len(data), 'byte')}, expected a multiple of {kind.itemsize}"
            )
        return np.frombuffer(data[:], kind)


def _gathered(path: Path, runs: NDArray, kind: np.dtype) -> NDArray:
    """Rows of all runs; offsets are in bytes of `data.bin`."""
    rows = np.empty(int(runs["count"].sum()), kind)
    flat, start = rows.view(np.uint8), 0
    with other_files(), opened(path) as data:
        for count, offset, _ in runs.tolist():
            size, first = count * kind.itemsize, offset * kind.itemsize // _ROW.itemsize
            if first + size > len(data):
                raise InvalidInput(
                    f"{path}: {counted(count, 'Gaussian')} at byte {first:,}, of {len(data):,}"
                )
            data.read_into(flat[start : start + size], first)
            start += size
    return rows
