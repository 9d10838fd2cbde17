"""What other programs read from scene files: the numbers as stored, in the file's own system.

`make peers` installs the programs.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from gs_codec.bench.peers.splat_transform import find_program
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import CONVENTION, OWN_SYSTEMS, turn_axes
from gs_codec.formats.packed_values import sigmoid, unit_quaternions
from gs_codec.formats.ply import read_ply
from gs_codec.scene import Scene

#: Where `make peers` puts packages of Node.
PACKAGES = Path(sys.prefix) / "peers/node_modules"

#: Opacities, from 0 to 1, that have a logit.
LEAST, MOST = 1e-9, 1 - 1e-7


@dataclass(frozen=True)
class OtherProgram:
    """A program that reads scenes.

    Parameters
    ----------
    formats : str
        What it reads: suffixes without their dots, `v4.spz` for version 4.
    read : callable
        The scene of each of some paths; `ModuleNotFoundError` or `MissingTool` if it is not
        installed, and any other error if it refuses a file.
    exact : bool
        Whether it keeps numbers as float32. If not, as Spark does: floats of 16 bits for scales,
        colours and opacities; SH-AC in 255 steps of a power of two, which cuts what is larger.
    """

    formats: str
    read: Callable[[Sequence[Path]], list[Scene]]
    exact: bool = True


def scene_from(columns: dict[str, np.ndarray]) -> Scene:
    """A scene of columns named as in a PLY, but for opacities, which are from 0 to 1."""
    share = np.clip(columns["opacity"], LEAST, MOST).astype(np.float64)
    rest = sum(name.startswith("f_rest") for name in columns)
    planes = {
        "positions": ["x", "y", "z"],
        "f_dc": [f"f_dc_{i}" for i in range(3)],
        "f_rest": [f"f_rest_{i}" for i in range(rest)],
        "log_scale": [f"scale_{i}" for i in range(3)],
        "rot": [f"rot_{i}" for i in range(4)],
    }
    return Scene(
        opacity=np.log(share / (1 - share)).astype(np.float32)[np.newaxis],
        **{
            group: np.array([columns[name] for name in names], np.float32).reshape(-1, len(share))
            for group, names in planes.items()
        },
    )


def scene_of_arrays(
    count: int,
    positions: np.ndarray,
    f_dc: np.ndarray,
    sh: np.ndarray,
    opacity: np.ndarray,
    log_scale: np.ndarray,
    rot: np.ndarray,
) -> Scene:
    """A scene of rows, or of what they are flattened to; SH (count, coefficient, colour)."""
    planes = (array.reshape(count, -1).T for array in (positions, f_dc, opacity, log_scale, rot))
    centres, colours, logits, scales, turns = (np.ascontiguousarray(plane) for plane in planes)
    sh = sh.reshape(count, -1, 3).transpose(2, 1, 0).reshape(-1, count)
    return Scene(
        positions=centres,
        f_dc=colours,
        f_rest=np.ascontiguousarray(sh),
        opacity=np.clip(logits, -30, 30),
        log_scale=scales,
        rot=turns,
    )


def read_by_gsply(paths: Sequence[Path]) -> list[Scene]:
    gsply = import_module("gsply")
    import_module("imagecodecs")
    readers = {".spz": gsply.read_spz, ".sog": gsply.sogread, ".ply": gsply.plyread}

    def scene(path: Path) -> Scene:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its kernels warn of threads
            read = readers[path.suffix](path)
        assert (read.is_scales_ply, read.is_opacities_ply, read.is_sh0_sh) == (True, True, True)
        sh = np.empty(0, np.float32) if read.shN is None else read.shN
        arrays = (read.means, read.sh0, sh, read.opacities, read.scales, read.quats)
        return scene_of_arrays(len(read.means), *arrays)

    return [scene(path) for path in paths]


def read_by_spz(paths: Sequence[Path]) -> list[Scene]:
    """By Niantic's library."""
    spz = import_module("spz")

    def scene(path: Path) -> Scene:
        cloud = spz.load_spz(str(path), spz.UnpackOptions())
        count = cloud.num_points
        assert count, f"{path}: refused"
        rot = cloud.rotations.reshape(count, 4)[:, [3, 0, 1, 2]]
        arrays = (cloud.positions, cloud.colors, cloud.sh, cloud.alphas, cloud.scales, rot)
        return scene_of_arrays(count, *arrays)

    return [scene(path) for path in paths]


def read_by_splat_transform(paths: Sequence[Path]) -> list[Scene]:
    program = find_program()[0]

    def scene(path: Path) -> Scene:
        target = path.with_name(f"{path.name}.read.ply")
        command = [program, "--quiet", "--overwrite", str(path), str(target)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert ended.returncode == 0, ended.stderr or ended.stdout
        return read_ply(target)

    return [scene(path) for path in paths]


def read_in_browser(program: str) -> Callable[[Sequence[Path]], list[Scene]]:
    def read(paths: Sequence[Path]) -> list[Scene]:
        browser, node = shutil.which("chromium"), shutil.which("node")
        if not (browser and node and PACKAGES.is_dir()):
            raise ModuleNotFoundError("Node, Chromium or packages")
        script = Path(__file__).with_name("browser_readers.mjs")
        command = [node, str(script), str(PACKAGES), browser, program, *map(str, paths)]
        subprocess.run(command, check=True, timeout=300)
        read = [
            json.loads(path.with_name(f"{path.name}.{program}.json").read_text()) for path in paths
        ]
        for path, columns in zip(paths, read, strict=True):
            assert "error" not in columns, f"{path.name}: {columns['error']}"
        return [
            scene_from({name: np.array(value) for name, value in columns.items()})
            for columns in read
        ]

    return read


PROGRAMS = {
    "gsply": OtherProgram("spz v4.spz sog compressed.ply", read_by_gsply),
    "spz": OtherProgram("spz v4.spz", read_by_spz),
    "splat-transform": OtherProgram(
        "spz v4.spz sog json compressed.ply splat", read_by_splat_transform
    ),
    "playcanvas": OtherProgram("sog json compressed.ply glb gltf", read_in_browser("playcanvas")),
    "spark": OtherProgram("spz sog compressed.ply splat", read_in_browser("spark"), exact=False),
}


def stored_numbers(path: Path) -> Scene:
    """What our reader makes of a file, in the system of its format."""
    return turn_axes(read_scene(path), OWN_SYSTEMS.get(path.suffix, CONVENTION))


def check(theirs: Scene, ours: Scene, form: str, exact: bool) -> None:
    """Equal but for roundings of floats, and for what the program makes of a step of the format."""
    assert theirs.count == ours.count
    if form in ("glb", "gltf"):
        # PlayCanvas orders them anew.
        theirs, ours = (scene.take(np.lexsort(scene.positions)) for scene in (theirs, ours))
    near = np.testing.assert_allclose
    farthest = np.abs(ours.positions).max()
    near(theirs.positions, ours.positions, rtol=2e-6, atol=1e-7 * farthest)
    near(theirs.f_dc, ours.f_dc, rtol=1e-3 * (not exact), atol=1e-5 if exact else 2e-3)
    near(theirs.log_scale, ours.log_scale, rtol=1e-6 if exact else 1e-3, atol=1e-5)
    # Our reader moves opacities of 0 and 1 by a quarter of a step of 8 bits.
    shares = [sigmoid(scene.opacity.astype(np.float64)) for scene in (theirs, ours)]
    near(*shares, rtol=0, atol=0.251 / 255 + 5e-4 * (not exact))
    first, second = (unit_quaternions(scene.rot) for scene in (theirs, ours))
    second = second * np.copysign(1, (first * second).sum(axis=0))
    # Some take 127.5 for the zero of .splat, not 128; Spark takes the angle from w alone.
    step = 1 / 128 if form == "splat" else 0
    turned = np.abs(second[0]) < (0.95 if step and not exact else np.inf)
    bound = step + (2e-4 if exact else 8e-3)
    near(first[:, turned], second[:, turned], rtol=0, atol=bound)
    # A program may fill SH up to degree 3 with zeros.
    sh, wanted = (scene.f_rest.reshape(3, -1, scene.count) for scene in (theirs, ours))
    stored = wanted.shape[1]
    assert not sh[:, stored:].any()
    limit, bound = np.inf, 1e-6
    if not exact and stored:
        limit = np.exp2(np.floor(np.log2(np.maximum(np.abs(wanted).max(axis=0), 2.0**-15))))
        bound = limit / 255
    # PlayCanvas has 255 steps from -4 to 4 in a .compressed.ply, its own writer 256.
    bound = bound + (0.5 / 32 if form == "compressed.ply" else 0)
    assert (np.abs(sh[:, :stored] - np.clip(wanted, -limit, limit)) <= bound).all()
