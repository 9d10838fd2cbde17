"""Seeded 3DGS scenes that look trained, of any size and SH degree, and cameras around them."""

from __future__ import annotations

import argparse
import json
import operator
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# Run as a script, only this folder is on the path, not the checkout around it.
if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gs_codec.errors import InvalidInput
from gs_codec.formats.ply import write_ply
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.scene import SH_COEFFICIENTS, Scene
from samples.surfaces import ROOM_RADIUS, SurfacePoints, still_life

#: Value of the constant spherical harmonic: rgb = 0.5 + SH_C0 * f_dc.
SH_C0 = 0.28209479177387814

#: Share of Gaussians far outside the room, and of those whose SH-AC is all zero.
FLOATER_SHARE = 0.015
FLAT_COLOUR_SHARE = 0.15

#: Most Gaussians `generate` makes: 24 GB of them at degree 3.
MAX_COUNT = 100_000_000

#: What the cameras look at: the middle of the objects on the table.
TARGET = (0.0, 0.0, 0.15)

# Gaussians made at once: limits scratch memory. Scenes of a seed depend on it.
_CHUNK = 1 << 17
_PARTS = ("surface", "colour", "scale", "rot", "opacity", "f_rest", "floaters")
_BAND_SCALE = np.repeat(np.array([0.055, 0.035, 0.025], np.float32), [3, 5, 7])

Generators = dict[str, np.random.Generator]
Planes = dict[str, NDArray[np.float32]]


def generate(count: int, sh_degree: int = 3, seed: int = 0) -> Scene:
    """Make a scene whose attributes are distributed as in a trained one.

    Parameters
    ----------
    count : int
        Number of Gaussians, 0 to `MAX_COUNT`. Their size follows, so that surfaces stay covered.
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
    count = _whole("count", count, 0, MAX_COUNT)
    sh_degree = _whole("sh_degree", sh_degree, 0, len(SH_COEFFICIENTS) - 1)
    seed = _whole("seed", seed, 0)
    rows = {"positions": 3, "f_dc": 3, "opacity": 1, "log_scale": 3, "rot": 4}
    rows["f_rest"] = 3 * SH_COEFFICIENTS[sh_degree]
    planes = {group: np.empty((n, count), np.float32) for group, n in rows.items()}
    generators = {name: np.random.default_rng([seed, i]) for i, name in enumerate(_PARTS)}
    for start, stop in _chunks(count):
        _fill({group: plane[:, start:stop] for group, plane in planes.items()}, count, generators)
    return Scene(**planes, has_normals=True)


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
    """`value` as an int, or InvalidInput unless it is whole and within the bounds."""
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


def _fill(planes: Planes, total: int, rng: Generators) -> None:
    """Fill the planes of one chunk of a scene of `total` Gaussians."""
    scene = still_life()
    points = scene.sample(planes["positions"].shape[1], rng["surface"])
    spacing = 1 / np.sqrt(total * scene.densities[points.part])
    gloss = np.array([surface.gloss for surface in scene.surfaces])[points.part]
    # Training leaves centres a little off the surface, by less than a splat is wide.
    off = 0.08 * spacing * rng["surface"].standard_normal(len(spacing))
    planes["positions"][:] = points.positions + off * points.normals
    planes["f_dc"][:] = (_noisy(scene.colours(points), rng["colour"]) - 0.5) / SH_C0
    axis = rng["rot"].integers(3, size=len(spacing))
    planes["log_scale"][:] = _log_scales(spacing, axis, rng["scale"])
    planes["rot"][:] = _rotations(points, axis, rng["rot"])
    planes["opacity"][:] = _opacities(len(spacing), rng["opacity"])
    _fill_sh(planes["f_rest"], gloss, rng["f_rest"])
    _add_floaters(planes, total, rng["floaters"])


def _noisy(rgb: NDArray, rng: np.random.Generator) -> NDArray:
    """Colours as training leaves them: noisy, mostly in brightness."""
    brightness = 0.035 * rng.standard_normal(rgb.shape[1])
    return rgb + brightness + 0.012 * rng.standard_normal(rgb.shape)


def _log_scales(spacing: NDArray, axis: NDArray, rng: np.random.Generator) -> NDArray:
    """Log-scales ``(3, N)`` of flat splats, the thin one in row `axis`."""
    z = rng.standard_normal((4, len(spacing)))
    tangent = np.log(0.8 * spacing) + 0.35 * z[0]
    thin = tangent - 2.2 + 0.7 * z[1]
    axes = np.array([tangent + 0.35 * z[2], tangent + 0.35 * z[3], np.minimum(thin, tangent - 0.7)])
    return np.take_along_axis(axes, _axis_order(axis), axis=0)


def _axis_order(axis: NDArray) -> NDArray:
    """Which of (tangent, tangent, normal) lies in each row, a cyclic turn."""
    return (np.arange(3)[:, None] + 2 - axis) % 3


def _rotations(points: SurfacePoints, axis: NDArray, rng: np.random.Generator) -> NDArray:
    """Quaternions wxyz ``(4, N)``, norm 0.7-1.3, that lay local axis `axis` along the normal."""
    x, y, z = points.normals
    # Shortest turn from z to the normal; straight down, where it is undefined, half a turn of x.
    down = z < -1 + 1e-9
    tilt = np.array([np.where(down, 0, 1 + z), np.where(down, 1, -y), x, 0 * z])
    half = np.pi * rng.random(len(axis))
    spin = np.array([np.cos(half), 0 * z, 0 * z, np.sin(half)])
    # Cyclic turns of the axes: normal on x, on y, on z.
    cycle = np.array([[0.5, -0.5, -0.5, -0.5], [0.5, 0.5, 0.5, 0.5], [1, 0, 0, 0]]).T[:, axis]
    q = _multiply(_multiply(tilt, spin), cycle)
    # Training starts at the identity, so w is seldom negative.
    q *= np.where((q[0] < 0) == (rng.random(len(axis)) < 0.95), -1, 1)
    norm = np.clip(1 + 0.1 * rng.standard_normal(len(axis)), 0.7, 1.3)
    return q * (norm / np.sqrt((q**2).sum(axis=0)))


def _multiply(p: NDArray, q: NDArray) -> NDArray:
    """Hamilton product of quaternions wxyz ``(4, N)``."""
    a, b, c, d = p
    e, f, g, h = q
    return np.array(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    )


def _opacities(count: int, rng: np.random.Generator) -> NDArray:
    """Logits ``(N,)``: near-opaque ones, and a tail of faint ones down to the trainer's cut."""
    opaque = rng.random(count) < 0.65
    z = rng.standard_normal(count)
    # The trainer prunes below an opacity of 0.005, a logit of -5.29.
    return np.clip(np.where(opaque, 4.5 + 1.8 * z, -1.2 + 1.9 * z), -5.29, 14.0)


def _fill_sh(f_rest: NDArray[np.float32], gloss: NDArray, rng: np.random.Generator) -> None:
    """Laplace SH-AC, smaller by band, mostly common to R, G, B, with a few strong Gaussians."""
    coefficients, count = len(f_rest) // 3, f_rest.shape[1]
    # A log-normal strength per Gaussian makes the tails heavier than Laplace's.
    strength = gloss * np.exp(0.45 * rng.standard_normal(count))
    strength[rng.random(count) < FLAT_COLOUR_SHARE] = 0
    scale = strength.astype(np.float32) * _BAND_SCALE[:coefficients, None]
    common = _laplace((coefficients, count), rng)
    for colour in f_rest.reshape(3, coefficients, count):
        colour[:] = scale * (0.92 * common + 0.39 * _laplace(common.shape, rng))


def _laplace(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    # A difference of exponentials: in float32 twice as fast as Generator.laplace.
    a = rng.standard_exponential(shape, dtype=np.float32)
    return a - rng.standard_exponential(shape, dtype=np.float32)


def _add_floaters(planes: Planes, total: int, rng: np.random.Generator) -> None:
    """Turn a small share of the Gaussians into large, faint, grey ones far outside."""
    chosen = np.flatnonzero(rng.random(planes["positions"].shape[1]) < FLOATER_SHARE)
    n = len(chosen)
    direction = rng.standard_normal((3, n))
    direction /= np.sqrt((direction**2).sum(axis=0))
    distance = ROOM_RADIUS * np.exp(rng.uniform(0.1, 1.8, n))
    planes["positions"][:, chosen] = distance * direction
    grey = 0.45 + 0.12 * rng.standard_normal(n)
    planes["f_dc"][:, chosen] = (_noisy(np.array([grey] * 3), rng) - 0.5) / SH_C0
    size = np.log(0.03 * distance) + 0.5 * rng.standard_normal(n)
    planes["log_scale"][:, chosen] = size + 0.5 * rng.standard_normal((3, n))
    planes["opacity"][:, chosen] = np.clip(-2.8 + rng.standard_normal(n), -5.29, -0.5)


def _arguments(argv: Sequence[str] | None) -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    parser = argparse.ArgumentParser(prog="generate.py", description=__doc__)
    parser.add_argument("out", metavar="OUT.ply", type=Path, help="scene to write")
    parser.add_argument("--gaussians", type=int, default=50_000, metavar="N", help="how many")
    parser.add_argument("--sh-degree", type=int, default=3, metavar="0-3")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cameras", type=Path, metavar="JSON", help="write an orbit here as well")
    return parser, parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Write a scene, and cameras if asked; exits with status 2 and one line on bad arguments."""
    parser, args = _arguments(argv)
    for path in filter(None, (args.out, args.cameras)):
        if path.is_dir() or not path.parent.is_dir():
            parser.error(f"{path}: cannot be written, expected a file in an existing folder")
    try:
        write_ply(args.out, generate(args.gaussians, args.sh_degree, args.seed))
        if args.cameras is not None:
            with atomic_writer(args.cameras) as file:
                file.write(json.dumps(orbit_cameras(), indent=1).encode() + b"\n")
    except InvalidInput as error:
        parser.error(str(error))
    except OSError as error:
        # The name in the error is that of a temporary file beside the output.
        folder = Path(error.filename or args.out).parent
        parser.error(f"cannot write in {folder}: {error.strerror or error}")


if __name__ == "__main__":
    main()
