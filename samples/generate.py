"""Generate a 3DGS scene of any size, or train a small one on simulated photographs."""

from __future__ import annotations

import argparse
import json
import math
import operator
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# When run as a script, only this folder is on the path, not the checkout.
if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.scene import SH_COEFFICIENTS, Scene
from samples.attributes import FAINTEST, fill_sh, log_scales, noisy, opacities, rotations
from samples.captures.capture import capture, write_capture
from samples.captures.rigs import RIGS
from samples.motion import MOTIONS, with_noise
from samples.motion import motion as motion_of
from samples.surfaces import ROOM_RADIUS, StillLife, still_life

#: Value of the constant spherical harmonic: rgb = 0.5 + SH_C0 * f_dc.
SH_C0 = 0.28209479177387814

#: Share of Gaussians far outside the room.
FLOATER_SHARE = 0.015

#: Maximum number of Gaussians that `generate` makes: 24 GB at degree 3.
MAX_COUNT = 100_000_000

#: Target of the cameras: the middle of the objects on the table.
TARGET = (0.0, 0.0, 0.15)

# Gaussians made at once: limits scratch memory. Scenes of a seed depend on it.
_CHUNK = 1 << 17
_PARTS = ("surface", "colour", "scale", "rot", "opacity", "f_rest", "floaters")

Generators = dict[str, np.random.Generator]
Planes = dict[str, NDArray[np.float32]]


def generate(count: int, sh_degree: int = 3, seed: int = 0) -> Scene:
    """Make a scene with the attribute distributions of a trained one.

    Parameters
    ----------
    count : int
        Number of Gaussians, 0 to `MAX_COUNT`. Their size adapts, so that surfaces stay covered.
    sh_degree : int
        SH degree, 0-3.
    seed : int
        0 or more. The same count, degree and seed give the same bytes.

    Returns
    -------
    Scene
        Unordered Gaussians of a still life in a room, z up, with ``has_normals`` set.

    Raises
    ------
    InvalidInput
        If an argument is out of range.
    """
    count, sh_degree, seed = _checked(count, sh_degree, seed)
    return _scene(still_life(), count, sh_degree, [seed])[0]


def sequence(
    motion: str,
    frames: int = 60,
    count: int = 50_000,
    sh_degree: int = 3,
    seed: int = 0,
    tracked: bool = True,
    noise: float = 0.0,
    fps: float = 30.0,
) -> Iterator[Scene]:
    """Make the frames of a scene in which something moves or changes, one at a time.

    Parameters
    ----------
    motion : str
        One of `samples.motion.MOTIONS`.
    frames : int
        Number of frames, 1 or more.
    count : int
        Number of Gaussians, 0 to `MAX_COUNT`; a fifth of them is on what moves or appears.
    sh_degree : int
        SH degree, 0-3.
    seed : int
        0 or more. The same arguments give the same bytes.
    tracked : bool
        Whether all frames have the same Gaussians in the same order. If not, each frame is sampled
        by itself, without the Gaussians that a trainer would remove because they are transparent.
    noise : float
        Strength of the noise of a trainer in all attributes, different in each frame; 0 or more,
        realistic at 1.
    fps : float
        Frames per second, above 0. All motions are periodic or end within 6 seconds.

    Yields
    ------
    Scene
        As from `generate`. Quaternions are rotated with the centres; SH are not, as in trainers.

    Raises
    ------
    InvalidInput
        If an argument is out of range.
    """
    count, sh_degree, seed = _checked(count, sh_degree, seed)
    frames = _whole("frames", frames, 1)
    if motion not in MOTIONS:
        raise InvalidInput(f"motion '{motion}': expected one of {', '.join(MOTIONS)}")
    if not 0 <= noise < math.inf:
        raise InvalidInput(f"noise: {noise}, expected 0 or more")
    if not 0 < fps < math.inf:
        raise InvalidInput(f"fps: {fps}, expected more than 0")
    moving = motion_of(motion)
    for number in range(frames):
        if number == 0 or not tracked:
            entropy = [seed] if tracked else [seed, number]
            rest, part = _scene(moving.rest, count, sh_degree, entropy)
        frame = moving.change(rest, part, number / fps)
        if not tracked:
            frame = frame.take(frame.opacity[0] >= np.float32(FAINTEST))
        rng = np.random.default_rng([seed, len(_PARTS), number])
        yield with_noise(frame, noise, rng) if noise else frame


def _checked(count: int, sh_degree: int, seed: int) -> tuple[int, int, int]:
    return (
        _whole("count", count, 0, MAX_COUNT),
        _whole("sh_degree", sh_degree, 0, len(SH_COEFFICIENTS) - 1),
        _whole("seed", seed, 0),
    )


def _scene(
    life: StillLife, count: int, sh_degree: int, entropy: list[int]
) -> tuple[Scene, NDArray[np.intp]]:
    """Sample a scene, and the surface of each Gaussian, -1 for floaters."""
    rows = {"positions": 3, "f_dc": 3, "opacity": 1, "log_scale": 3, "rot": 4}
    rows["f_rest"] = 3 * SH_COEFFICIENTS[sh_degree]
    planes = {group: np.empty((n, count), np.float32) for group, n in rows.items()}
    part = np.empty(count, np.intp)
    generators = {name: np.random.default_rng([*entropy, i]) for i, name in enumerate(_PARTS)}
    for start, stop in _chunks(count):
        chunk = {group: plane[:, start:stop] for group, plane in planes.items()}
        part[start:stop] = _fill(chunk, count, life, generators)
    return Scene(**planes, has_normals=True), part


def orbit_cameras(count: int = 24, width: int = 400, height: int = 266) -> list[dict]:
    """Cameras on a circle at two alternating heights, looking at the still life.

    Parameters
    ----------
    count : int
        Number of cameras.
    width, height : int
        Size of the image, pixels.

    Returns
    -------
    list of dict
        The INRIA ``cameras.json``: ``rotation`` is camera-to-world with the columns right,
        down, forward (OpenCV), ``position`` the centre in the world, ``fx`` and ``fy`` pixels.

    Raises
    ------
    InvalidInput
        If an argument is not a positive whole number.
    """
    sizes = {"count": count, "width": width, "height": height}
    count, width, height = (_whole(name, value, 1) for name, value in sizes.items())
    return [_camera(i, 2 * np.pi * i / count, width, height) for i in range(count)]


def _camera(number: int, angle: float, width: int, height: int) -> dict:
    position = np.array([2.9 * np.cos(angle), 2.9 * np.sin(angle), (0.8, 1.5)[number % 2]])
    forward = np.array(TARGET) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return {
        "id": number,
        "img_name": f"{number:05d}",
        "width": width,
        "height": height,
        "position": position.tolist(),
        "rotation": rotation.tolist(),
        "fy": float(width),
        "fx": float(width),
    }


def _whole(name: str, value: int, low: int, high: int | None = None) -> int:
    """Convert `value` to an int; InvalidInput unless it is a whole number within the bounds."""
    expected = f"{low} or more" if high is None else f"{low}-{high}"
    try:
        number = operator.index(value)
    except TypeError as error:
        raise InvalidInput(f"{name}: {value!r}, expected a whole number, {expected}") from error
    if number < low or (high is not None and number > high):
        raise InvalidInput(f"{name}: {number}, expected {expected}")
    return number


def _chunks(count: int) -> Iterator[tuple[int, int]]:
    for start in range(0, count, _CHUNK):
        yield start, min(start + _CHUNK, count)


def _fill(planes: Planes, total: int, scene: StillLife, rng: Generators) -> NDArray[np.intp]:
    """Fill the planes of one chunk of a scene of `total` Gaussians; return their surfaces."""
    points = scene.sample(planes["positions"].shape[1], rng["surface"])
    spacing = 1 / np.sqrt(total * scene.densities[points.part])
    gloss = np.array([surface.gloss for surface in scene.surfaces])[points.part]
    # Training leaves centres slightly off the surface, by less than the width of a splat.
    off = 0.08 * spacing * rng["surface"].standard_normal(len(spacing))
    planes["positions"][:] = points.positions + off * points.normals
    planes["f_dc"][:] = (noisy(scene.colours(points), rng["colour"]) - 0.5) / SH_C0
    axis = rng["rot"].integers(3, size=len(spacing))
    planes["log_scale"][:] = log_scales(spacing, axis, rng["scale"])
    planes["rot"][:] = rotations(points, axis, rng["rot"])
    planes["opacity"][:] = opacities(len(spacing), rng["opacity"])
    fill_sh(planes["f_rest"], gloss, rng["f_rest"])
    points.part[_add_floaters(planes, rng["floaters"])] = -1
    return points.part


def _add_floaters(planes: Planes, rng: np.random.Generator) -> NDArray[np.intp]:
    """Turn a small share of the Gaussians into large, faint, grey ones far outside."""
    chosen = np.flatnonzero(rng.random(planes["positions"].shape[1]) < FLOATER_SHARE)
    n = len(chosen)
    direction = rng.standard_normal((3, n))
    direction /= np.sqrt((direction**2).sum(axis=0))
    distance = ROOM_RADIUS * np.exp(rng.uniform(0.1, 1.8, n))
    planes["positions"][:, chosen] = distance * direction
    grey = 0.45 + 0.12 * rng.standard_normal(n)
    planes["f_dc"][:, chosen] = (noisy(np.array([grey] * 3), rng) - 0.5) / SH_C0
    size = np.log(0.03 * distance) + 0.5 * rng.standard_normal(n)
    planes["log_scale"][:, chosen] = size + 0.5 * rng.standard_normal((3, n))
    planes["opacity"][:, chosen] = np.clip(-2.8 + rng.standard_normal(n), FAINTEST, -0.5)
    return chosen


def _arguments(argv: Sequence[str] | None) -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    parser = argparse.ArgumentParser(prog="generate.py", description=__doc__)
    parser.add_argument(
        "out", metavar="OUT", type=Path, help="PLY to write; with --capture, a folder"
    )
    parser.add_argument(
        "--gaussians",
        type=int,
        metavar="N",
        help="number of Gaussians (default: 50000; 12000 at the start of a capture)",
    )
    parser.add_argument("--sh-degree", type=int, metavar="0-3", help="SH degree (default: 3)")
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument(
        "--cameras",
        type=Path,
        metavar="JSON",
        help="cameras.json to write, with 24 cameras on a circle",
    )
    parser.add_argument("--overwrite", action="store_true", help="overwrite existing output")
    parser.add_argument(
        "--capture",
        choices=list(RIGS),
        help="train a scene on simulated photographs of this kind, in about half a minute; "
        "OUT gets point_cloud.ply, cameras.json and the photographs in images",
    )
    parser.add_argument(
        "--iterations",
        type=int,
        metavar="N",
        help="iterations of a capture (default: 600)",
    )
    moving = parser.add_argument_group("sequences")
    moving.add_argument(
        "--sequence",
        choices=MOTIONS,
        help="write the frames of a scene with this motion; OUT gets 0000.ply, 0001.ply, ...",
    )
    moving.add_argument("--frames", type=int, metavar="N", help="number of frames (default: 60)")
    moving.add_argument("--fps", type=float, metavar="F", help="frames per second (default: 30)")
    moving.add_argument(
        "--kind",
        choices=("tracked", "untracked"),
        help="the same Gaussians in all frames, or new ones in each (default: tracked)",
    )
    moving.add_argument(
        "--noise",
        type=float,
        nargs="?",
        const=1.0,
        metavar="STRENGTH",
        help="add the noise of a trainer, different in each frame (alone: 1, which is realistic)",
    )
    return parser, parser.parse_args(argv)


def _check_outputs(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    if args.sequence is None:
        for option in ("frames", "fps", "kind", "noise"):
            if getattr(args, option) is not None:
                parser.error(f"--{option}: expected --sequence too")
    folder = args.capture is not None or args.sequence is not None
    for path in filter(None, (None if folder else args.out, args.cameras)):
        if path.is_dir() or not path.parent.is_dir():
            parser.error(f"{path}: cannot be written, expected a file in an existing folder")
    if args.capture is None and args.iterations is not None:
        parser.error("--iterations: expected --capture too")
    for option in ("sh_degree", "cameras", "sequence"):
        if args.capture is not None and getattr(args, option) is not None:
            name = "--" + option.replace("_", "-")
            parser.error(f"{name}: not with --capture, which has SH degree 3 and its own cameras")
    if args.sequence is not None and args.out.is_dir() and any(args.out.iterdir()):
        parser.error(f"{args.out}: expected an empty or new folder")
    if not folder:
        return
    if (args.out.exists() and not args.out.is_dir()) or not args.out.parent.is_dir():
        parser.error(f"{args.out}: expected a folder, or a new one in an existing folder")


def _check_overwrite(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    if args.sequence is not None and args.overwrite:
        parser.error("--overwrite: not with --sequence, which needs an empty or new folder")
    for path in filter(None, (args.out, args.cameras)):
        written = any(path.iterdir()) if path.is_dir() else path.exists()
        if written and not args.overwrite:
            parser.error(f"{path}: already exists; choose another name or pass --overwrite")


def _write(args: argparse.Namespace) -> None:
    given = {"count": args.gaussians, "sh_degree": args.sh_degree, "seed": args.seed}
    given["iterations"] = args.iterations
    given = {name: value for name, value in given.items() if value is not None}
    if args.capture is not None:
        write_capture(args.out, capture(args.capture, **given))
        return
    if args.sequence is not None:
        given |= {"tracked": args.kind != "untracked", "noise": args.noise or 0.0}
        timing = {"frames": args.frames, "fps": args.fps}
        given |= {name: value for name, value in timing.items() if value is not None}
        for number, frame in enumerate(sequence(args.sequence, **given)):
            args.out.mkdir(exist_ok=True)
            write_ply(args.out / f"{number:04d}.ply", frame)
    else:
        write_ply(args.out, generate(**{"count": 50_000} | given))
    if args.cameras is not None:
        with atomic_writer(args.cameras) as file:
            file.write(json.dumps(orbit_cameras(), indent=1).encode() + b"\n")


def main(argv: Sequence[str] | None = None) -> None:
    """Write a scene, and optionally cameras; exit with status 2 and one line on bad arguments."""
    parser, args = _arguments(argv)
    _check_outputs(parser, args)
    _check_overwrite(parser, args)
    try:
        _write(args)
    except InvalidInput as error:
        parser.error(str(error))
    except OSError as error:
        # The error names a temporary file next to the output.
        folder = Path(error.filename or args.out).parent
        parser.error(f"cannot write in {folder}: {error.strerror or error}")


if __name__ == "__main__":
    main()
