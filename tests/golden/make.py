"""Write missing golden files. Run by hand after adding to the format.

    python tests/golden/make.py

Each `.egs` is stored with the floats it decoded to when it was made. tests/test_golden.py only
reads both.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from moving_scenes import decode, encoded, varied  # noqa: E402
from scenes import (  # noqa: E402
    SmallBlocks,
    encode_by,
    made_up_guide,
    moved_apart,
    random_scene,
    seen_from,
    with_far,
)

from gs_codec.codecs import decode_part, decode_scene, encode_parts  # noqa: E402
from gs_codec.codecs.part import Part  # noqa: E402
from gs_codec.config import Config  # noqa: E402
from gs_codec.egs.egs_file import read_file  # noqa: E402
from gs_codec.egs.index import levels_of  # noqa: E402
from gs_codec.levels.adding import add_levels  # noqa: E402
from gs_codec.scene import GROUPS, Scene  # noqa: E402

#: Step sizes for the encoder, by name. The error is that of `m` when files of version 1 were
#: written.
GUIDES = {
    "v1-guided": made_up_guide(seed=103, error=2e-5),
    "v2-far-guided": made_up_guide(seed=107),
}


def golden_scenes() -> dict[str, tuple[Scene, Config]]:
    """Scenes and options that together use every part of the format, by file name."""
    return {f"v1-{name}": case for name, case in _golden_scenes().items()} | {
        "v2-basis": (
            # The second block has no basis.
            moved_apart(seen_from(random_scene(1050, 3, seed=109), 3), random_scene(1050, 3)),
            Config("m", block_size=1050),
        ),
        "v2-basis-runs": (
            moved_apart(
                seen_from(random_scene(1050, 1, seed=110), 1),
                seen_from(random_scene(1050, 1, seed=113), 1, seed=1),
            ),
            Config("l"),
        ),
        "v2-basis-far": (
            with_far(seen_from(random_scene(400, 2, seed=111), 2), 20),
            Config("s"),
        ),
        "v2-far": (
            with_far(random_scene(1100, 3, seed=106), 11),
            Config("m", block_size=1024),
        ),
        "v2-far-guided": (
            with_far(random_scene(1100, 1, seed=107), 110),
            Config("m", block_size=1024),
        ),
    }


def _golden_scenes() -> dict[str, tuple[Scene, Config]]:
    """Scenes of version 1."""
    plain = random_scene(1500, 3, seed=100)
    carried = replace(
        random_scene(40, 1, seed=101),
        has_normals=True,
        comments=("a golden file", "SplatRenderMode: mip", "CoordinateSystem: RUB"),
        extra={"label": np.arange(40, dtype="<i2")},
    )
    flat = random_scene(300, 2, seed=102)
    flat.positions[2] = 1.5
    flat.f_dc[1] = 0.25
    flat.rot[:] = np.array([[1], [0], [0], [0]], np.float32)
    bits = replace(random_scene(1100, 1, seed=103), extra={"label": np.arange(1100, dtype="<u2")})
    bits.f_rest[0:3, 5:400] = 0
    bits.f_rest[3:6, 300:500] = 0
    bits.f_rest[:, 600:700] = 0
    for row, pattern in enumerate((0x7FC12345, 0xFF812345, 0x80000000, 0x7F800000, 0x00000001)):
        for group in GROUPS:
            getattr(bits, group)[0, 10 * row] = np.array(pattern, "<u4").view("<f4")
    unit = random_scene(60, 3, seed=104)
    unit.rot[:] = unit.rot / np.linalg.norm(unit.rot, axis=0) * np.where(unit.rot[0] < 0, -1, 1)
    return {
        "paper-l": (plain, Config("paper-l", models="best", block_size=1024)),
        "paper-m": (plain, Config("paper-m", models="best", block_size=1024)),
        "paper-s": (plain, Config("paper-s", models="best", block_size=1024)),
        "carried": (carried, Config("paper-m", models="best", extra="keep")),
        "constant": (flat, Config("paper-m", models="best")),
        "deep": (
            plain.take(np.arange(200)),
            Config("paper-m", depths={"geometry": 21, "sh-ac": 12}, models="best"),
        ),
        "lossless": (bits, Config("lossless", extra="keep", block_size=1024)),
        "lossless-kept": (unit, Config("lossless", keep_order=True)),
        "empty": (random_scene(0, 3), Config("paper-m")),
        "l": (plain.take(np.arange(200)), Config("l")),
        "m": (plain, Config("m", block_size=1024)),
        "s": (plain.take(np.arange(200)), Config("s")),
        "guided": (random_scene(1100, 1, seed=104), Config("m", block_size=1024)),
        "carried-m": (carried, Config("m", extra="keep")),
        "empty-m": (random_scene(0, 3), Config("m")),
    }


def golden_levels() -> dict[str, Callable[[], bytes]]:
    """Files with three levels of detail; merging may differ between machines."""

    def encode(scene: Scene) -> bytes:
        config = SmallBlocks("m", lod=True)
        return b"".join(add_levels(*encode_parts(scene, config), config)[0])

    return {
        "v1-levels": lambda: encode(random_scene(600, 1, seed=105)),
        "v2-basis-levels": lambda: encode(seen_from(random_scene(600, 2, seed=112), 2)),
        "v2-far-levels": lambda: encode(with_far(random_scene(600, 1, seed=108), 30)),
    }


def golden_sequences() -> dict[str, Callable[[], bytes]]:
    """Files of five frames in two groups, in which far Gaussians and bases change too."""
    first = with_far(seen_from(random_scene(64, 2, seed=114), 2, scale=10.0), 8)
    return {"v2-sequence": lambda: encoded(varied(first, 5), 40, "s", 3)}


def main() -> None:
    """Encode, decode, and store both."""
    for name, encode in golden_sequences().items():
        stem = HERE / name
        if stem.with_suffix(".egs").exists():
            continue
        data = encode()
        stem.with_suffix(".egs").write_bytes(data)
        frames = enumerate(decode(data))
        planes = {f"frame {k} {g}": getattr(scene, g) for k, scene in frames for g in GROUPS}
        np.savez_compressed(stem.with_suffix(".npz"), **planes)
        print(f"{stem.name}: {len(data)} bytes")
    for name, encode in golden_levels().items():
        stem = HERE / name
        if stem.with_suffix(".egs").exists():
            continue
        data = encode()
        stem.with_suffix(".egs").write_bytes(data)
        planes = {group: getattr(decode_scene(data), group) for group in GROUPS}
        for level in levels_of(read_file(data)):
            scene = decode_part(data, Part(level=level))[0]
            planes |= {f"level {level} {group}": getattr(scene, group) for group in GROUPS}
        np.savez_compressed(stem.with_suffix(".npz"), **planes)
        print(f"{stem.name}: {len(data)} bytes")
    for name, (scene, config) in golden_scenes().items():
        stem = HERE / name
        if stem.with_suffix(".egs").exists():
            print(f"{stem.name}: exists already, left as it is")
            continue
        data = encode_by(scene, config, GUIDES.get(name))
        decoded = decode_scene(data)
        stem.with_suffix(".egs").write_bytes(data)
        planes = {group: getattr(decoded, group) for group in GROUPS}
        np.savez_compressed(stem.with_suffix(".npz"), **planes)
        print(f"{stem.name}: {len(data)} bytes")


if __name__ == "__main__":
    main()
