"""Write the golden files of other formats, and what a native program of each format reads.

    python tests/golden/make_other.py

Needs the programs that `make peers` installs; tests/test_golden.py only reads the files.
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from other_programs import PROGRAMS  # noqa: E402
from scenes import random_scene  # noqa: E402

from gs_codec.formats.gltf.scene import pack_gltf  # noqa: E402
from gs_codec.formats.ply.packed import pack_ply  # noqa: E402
from gs_codec.formats.sog.writer import pack_sog  # noqa: E402
from gs_codec.formats.splat import pack_splat  # noqa: E402
from gs_codec.formats.spz.scene import pack_spz  # noqa: E402
from gs_codec.scene import GROUPS  # noqa: E402

#: The writer of each format, at its finest, and the native program that reads its golden file.
HOME = {
    "spz": (pack_spz, "spz"),
    "v4.spz": (partial(pack_spz, version=4), "spz"),
    "sog": (pack_sog, "splat-transform"),
    "compressed.ply": (pack_ply, "splat-transform"),
    "splat": (pack_splat, "splat-transform"),
    "glb": (pack_gltf, "playcanvas"),
}

#: Number of Gaussians of a golden file; more than one chunk of a .compressed.ply.
COUNT = 260


def written(form: str, folder: Path) -> Path:
    """Write the scene of the golden file to a folder."""
    target = folder / f"other.{form}"
    target.write_bytes(HOME[form][0](random_scene(COUNT, 3, seed=105))[0])
    return target


def main() -> None:
    """Write each file, let its program read it, and store the result."""
    for form, (_, program) in HOME.items():
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
