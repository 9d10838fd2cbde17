"""Attributes as a text table (CSV): one line per Gaussian, columns as in a PLY."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from gs_codec.format_table import CSV
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.packed_values import spans
from gs_codec.formats.ply.writer import vertex_rows
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.scene import Scene

#: Digits that distinguish all numbers of a type; integers are exact.
_DIGITS = {4: "%.9g", 8: "%.17g"}


def write_csv(path: str | Path, scene: Scene) -> tuple[str, ...]:
    """Write a table of all attributes and extra properties; every float can be read back exactly.

    Returns
    -------
    tuple of str
        Sentences on what it cannot represent.
    """
    scene = replace(scene, has_normals=False)
    types = vertex_rows(scene.between(0, 0)).dtype
    names = types.names or ()
    formats = [_DIGITS[types[n].itemsize] if types[n].kind == "f" else "%d" for n in names]
    head = io.StringIO()
    csv.writer(head, lineterminator="\n").writerow(names)
    with atomic_writer(path) as file:
        file.write(head.getvalue().encode())
        for some in spans(scene.count):
            rows = vertex_rows(scene.between(some.start, some.stop))
            np.savetxt(file, rows, formats, ",")
    return tuple(left_out_of(scene, CSV))
