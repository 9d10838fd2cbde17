"""Write the golden files of other formats, and what a program at home in each reads from it.

    python tests/golden/make_other.py

Needs the programs that `make peers` installs; tests/test_golden.py reads the files and never
writes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from other_programs import FORMATS, PROGRAMS  # noqa: E402
from scenes import random_scene  # noqa: E402

from gs_codec.files.conversion import convert_file  # noqa: E402
from gs_codec.formats.ply import write_ply  # noqa: E402
from gs_codec.scene import GROUPS  # noqa: E402

#: What reads the golden file of a format; its number of Gaussians, more than a chunk has.
HOME = {
    "spz": ("spz", 40),
    "v4.spz": ("spz", 40),
    "sog": ("splat-transform", 40),
    "compressed.ply": ("splat-transform", 300),
    "splat": ("splat-transform", 40),
    "glb": ("playcanvas", 40),
}


def written(form: str, folder: Path) -> Path:
    """The scene of the golden file, written to a folder."""
    source, target = folder / "scene.ply", folder / f"other.{form}"
    write_ply(source, random_scene(HOME[form][1], 3, seed=105))
    convert_file(source, target, FORMATS[form][1])
    return target


def main() -> None:
    """Write each file, have it read, and store what was read."""
    for form, (program, _) in HOME.items():
        golden = HERE / f"other.{form}"
        if golden.exists():
            print(f"{golden.name}: exists already, left as it is")
            continue
        with tempfile.TemporaryDirectory() as folder:
            target = written(form, Path(folder))
            [read] = PROGRAMS[program].read([target])
            golden.write_bytes(target.read_bytes())
        planes = {group: getattr(read, group) for group in GROUPS}
        np.savez_compressed(HERE / f"other.{form}.npz", **planes)
        print(f"{golden.name}: {golden.stat().st_size} bytes")


if __name__ == "__main__":
    main()
