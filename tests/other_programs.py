"""What other programs read from scene files: stored numbers, in the file's coordinate system.

`make peers` installs the programs.
"""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
from web_pages import CHROMIUM, NODE

from gs_codec.bench.peers import AbsentPeer, find_splat_transform, spz_peer
from gs_codec.errors import MissingTool
from gs_codec.files.scenes import read_scene
from gs_codec.format_table import SPZ, format_of
from gs_codec.formats.coordinates import CONVENTION, turn_axes
from gs_codec.formats.packed_values import logits_of, sigmoid, unit_quaternions
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.tensors import NAMES, scene_of_tensors
from gs_codec.scene import Scene, property_names

#: Folder of Node packages from `make peers`.
PACKAGES = Path(sys.prefix) / "peers/node_modules"


@dataclass(frozen=True)
class OtherProgram:
    """A program that reads scenes.

    Parameters
    ----------
    formats : str
        Formats that it reads: suffixes without dots, `v4.spz` for version 4.
    read : callable
        Reads the scene of each path. Raises `ModuleNotFoundError` or `MissingTool` if it is not
        installed, and any other error if it rejects a file.
    exact : bool
        Whether it keeps float32. If not (Spark): 16-bit floats for scales, colours and opacities;
        SH-AC in 255 steps of a power of two, clamped.
    """

    formats: str
    read: Callable[[Sequence[Path]], list[Scene]]
    exact: bool = True


def scene_from(columns: dict[str, np.ndarray]) -> Scene:
    """A scene from columns named as in a PLY, except that opacities are 0 to 1."""
    columns = {**columns, "opacity": logits_of(columns["opacity"])}
    coefficients = sum(name.startswith("f_rest") for name in columns) // 3
    return Scene(
        **{
            group: np.array([columns[name] for name in names], np.float32).reshape(
                len(names), len(columns["x"])
            )
            for group, names in property_names(coefficients).items()
        }
    )


def read_by_gsply(paths: Sequence[Path]) -> list[Scene]:
    gsply = import_module("gsply")
    import_module("imagecodecs")
    readers = {".spz": gsply.read_spz, ".sog": gsply.sogread, ".ply": gsply.plyread}

    def scene(path: Path) -> Scene:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its kernels warn about threads
            read = readers[path.suffix](path)
        assert (read.is_scales_ply, read.is_opacities_ply, read.is_sh0_sh) == (True, True, True)
        tensors = {name: getattr(read, name) for name in NAMES}
        return scene_of_tensors({n: tensor for n, tensor in tensors.items() if tensor is not None})

    return [scene(path) for path in paths]


def read_by_spz(paths: Sequence[Path]) -> list[Scene]:
    """Read with Niantic's library, converted to `RDF`; only signs change."""
    peer = spz_peer("error")
    if isinstance(peer, AbsentPeer):
        raise MissingTool(peer.absent)
    scenes = [peer.scene(peer.decode(path.read_bytes())) for path in paths]
    return [turn_axes(scene, SPZ.system) for scene in scenes]


def read_by_splat_transform(paths: Sequence[Path]) -> list[Scene]:
    program = find_splat_transform()[0]

    def scene(path: Path) -> Scene:
        target = path.with_name(f"{path.name}.read.ply")
        command = [program, "--quiet", "--overwrite", str(path), str(target)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert ended.returncode == 0, ended.stderr or ended.stdout
        return read_ply(target)

    return [scene(path) for path in paths]


def read_in_browser(program: str) -> Callable[[Sequence[Path]], list[Scene]]:
    def read(paths: Sequence[Path]) -> list[Scene]:
        if not (CHROMIUM and NODE and PACKAGES.is_dir()):
            raise ModuleNotFoundError("Node, Chromium or packages")
        if not paths:
            return []
        script = Path(__file__).with_name("browser_readers.mjs")
        command = [NODE, str(script), str(PACKAGES), CHROMIUM, program, *map(str, paths)]
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
    "spark": OtherProgram(
        "spz sog rad compressed.ply splat", read_in_browser("spark"), exact=False
    ),
}


def stored_numbers(path: Path) -> Scene:
    """What our reader reads from a file, in the coordinate system of the format."""
    return turn_axes(read_scene(path), format_of(path.suffix).system or CONVENTION)


def check(theirs: Scene, ours: Scene, form: str, exact: bool) -> None:
    """Equal, up to float rounding and the program's interpretation of the format."""
    assert theirs.count == ours.count
    if form in ("glb", "gltf"):
        # PlayCanvas reorders Gaussians.
        theirs, ours = (scene.take(np.lexsort(scene.positions)) for scene in (theirs, ours))
    near = np.testing.assert_allclose
    farthest = np.abs(ours.positions).max()
    near(theirs.positions, ours.positions, rtol=2e-6, atol=1e-7 * farthest)
    near(theirs.f_dc, ours.f_dc, rtol=1e-3 * (not exact), atol=1e-5 if exact else 2e-3)
    near(theirs.log_scale, ours.log_scale, rtol=1e-6 if exact else 1e-3, atol=1e-5)
    # Our reader moves opacities of 0 and 1 by a quarter of an 8-bit step.
    shares = [sigmoid(scene.opacity.astype(np.float64)) for scene in (theirs, ours)]
    near(*shares, rtol=0, atol=0.251 / 255 + 5e-4 * (not exact))
    first, second = (unit_quaternions(scene.rot) for scene in (theirs, ours))
    second = second * np.copysign(1, (first * second).sum(axis=0))
    # Some use 127.5 as the zero of .splat, not 128; Spark computes the angle from w alone.
    step = 1 / 128 if form == "splat" else 0
    turned = np.abs(second[0]) < (0.95 if step and not exact else np.inf)
    bound = step + (2e-4 if exact else 8e-3)
    near(first[:, turned], second[:, turned], rtol=0, atol=bound)
    # A program may pad SH with zeros up to degree 3.
    sh, wanted = (scene.f_rest.reshape(3, -1, scene.count) for scene in (theirs, ours))
    stored = wanted.shape[1]
    assert not sh[:, stored:].any()
    limit, bound = np.inf, 1e-6
    if not exact and stored:
        limit = np.exp2(np.floor(np.log2(np.maximum(np.abs(wanted).max(axis=0), 2.0**-15))))
        bound = limit / 255
    # PlayCanvas reads 255 steps from -4 to 4 in a .compressed.ply; its own writer uses 256.
    bound = bound + (0.5 / 32 if form == "compressed.ply" else 0)
    assert (np.abs(sh[:, :stored] - np.clip(wanted, -limit, limit)) <= bound).all()
