"""``bench losses``: the loss of captures in held-out views, with and without cameras.

A capture is a scene with a cameras.json that marks some cameras as ``test``. Those measure the loss
of encoding camera-free, with estimated cameras, and with the other cameras of the file.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.bench.measured_scenes import MeasuredScene, cameras_of, open_scene
from gs_codec.cameras.camera import Camera
from gs_codec.config import RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.pages.tables import Table, number
from gs_codec.plan import Plan, Steps
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, psnr_loss, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Target loss of camera-free `m`, dB.
WANTED = 0.05

#: Tolerance of this loss, dB.
WITHIN = 0.015

#: Maximum loss with estimated cameras, dB.
MOST = 0.1

#: Maximum extra loss of estimated cameras compared with camera-free at equal size, dB.
WORSE = 0.02

#: Ways to encode: camera-free, with estimated cameras, with cameras of the file.
FREE = "free"
ESTIMATED = "estimated"
GIVEN = "given"

#: Size limits, relative to a given size, of two camera-free files between which the loss is
#: interpolated.
_AROUND = (1.0, 1.025)

Line = dict[str, Any]


class _Coded(NamedTuple):
    """Size of a file, mean squared error of its views, and the encoder's own loss estimate, dB."""

    size: int
    error: float
    reported: float | None


class _Views:
    """Held-out views of a scene, rendered once."""

    def __init__(self, scene: Scene, cameras: Sequence[Camera]) -> None:
        self._cameras = cameras
        self._images = [self._draw(scene, camera) for camera in cameras]

    @staticmethod
    def _draw(scene: Scene, camera: Camera) -> NDArray[np.float32]:
        return np.clip(render(scene, camera, device="cpu").colour, 0, 1)

    def error(self, scene: Scene) -> float:
        """Mean squared error of another scene's views."""

        def compare(i: int) -> float:
            image = self._draw(scene, self._cameras[i])
            return float(np.mean((image - self._images[i]) ** 2, dtype=np.float64))

        return float(np.mean(run_all(compare, range(len(self._cameras)))))


def measure_losses(paths: Sequence[Path], progress: Progress | None = None) -> Iterator[Line]:
    """A result line for each capture.

    Raises InvalidInput if a scene has no cameras.json next to it, or none or all of its cameras are
    marked.
    """
    captures = [_open(path) for path in paths]
    for capture in captures:
        yield _measure(capture, progress)


def _open(path: Path) -> MeasuredScene:
    cameras = cameras_of(path)
    if cameras == "auto":
        raise InvalidInput(f"{path}: no cameras.json in its folder, expected one to measure losses")
    capture = open_scene(path, cameras, None, None)
    splits = [{camera.split for camera in part} for part in (capture.cameras, capture.guides)]
    if splits[0] != {"test"} or "test" in splits[1]:
        raise InvalidInput(f"{cameras}: expected some but not all cameras marked 'test'")
    return capture


def _measure(capture: MeasuredScene, progress: Progress | None) -> Line:
    plans: dict[str, Plan | None] = {
        FREE: None,
        ESTIMATED: Plan(Steps(), "auto"),
        GIVEN: Plan(Steps(), capture.guides),
    }
    views, count = _Views(capture.scene, capture.cameras), capture.scene.count
    advance = step_counter(progress, capture.name, len(plans))
    line: Line = {"kind": "losses", "scene": capture.name, "gaussians": count}
    line["views"] = len(capture.cameras)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "coded.egs"

        def encode(plan: Plan | None = None, size: int | None = None) -> _Coded:
            rate = None if size is None else RateTarget(size=size)
            report = encode_file(capture.path, target, plan=plan, rate=rate, overwrite=True)
            said = None if report.rendered is None else report.rendered.loss
            return _Coded(report.file_bytes, views.error(read_scene(target)), said)

        for way, plan in plans.items():
            coded = encode(plan)
            line[way] = {
                "bits_per_gaussian": 8 * coded.size / count,
                "loss": psnr_loss(coded.error),
                "reported": coded.reported,
            }
            if plan is not None:
                around = [encode(size=round(share * coded.size)) for share in _AROUND]
                line[way]["free_loss"] = psnr_loss(_between(coded.size, around))
            advance()
    return line


def _between(size: int, coded: Sequence[_Coded]) -> float:
    """The error at a size, interpolated between a smaller and a larger file."""
    logs = np.log([max(each.error, 1e-30) for each in coded])
    return float(np.exp(np.interp(size, [each.size for each in coded], logs)))


def misses_of(line: Line, margin: float = 0.0) -> dict[str, float]:
    """The targets that a capture misses by more than a margin in dB, and by how many dB.

    ``free``: too far from the target loss; ``estimated``: too high a loss; ``worse``: worse than
    camera-free at equal size.
    """
    free, estimated = line[FREE], line[ESTIMATED]
    misses = {
        FREE: abs(free["loss"] - WANTED) - WITHIN,
        ESTIMATED: estimated["loss"] - MOST,
        "worse": estimated["loss"] - estimated["free_loss"] - WORSE,
    }
    return {aim: miss for aim, miss in misses.items() if miss > margin}


def loss_table(lines: Sequence[Line]) -> list[str]:
    """A Markdown table, and the number of captures that meet each target."""
    columns = [
        "capture", "Gaussians", "views", "bits", "loss", "reported",
        "bits, estimated", "loss", "camera-free", "bits, given", "loss", "camera-free", "misses",
    ]  # fmt: skip
    rows = [_row(line) for line in lines]
    met = [
        f"{aim}: {sum(key not in misses_of(line) for line in lines)} of {len(lines)}"
        for key, aim in (
            (FREE, f"camera-free {WANTED} +- {WITHIN} dB"),
            (ESTIMATED, f"estimated cameras lose at most {MOST} dB"),
            ("worse", f"and at most {WORSE} dB more than camera-free at equal size"),
        )
    ]
    return [*Table(columns, rows, left=(0, -1)).markdown().splitlines(), "", *met]


def _row(line: Line) -> list[str]:
    free = line[FREE]
    row = [line["scene"], f"{line['gaussians']:,}", str(line["views"])]
    row += [f"{free['bits_per_gaussian']:.1f}", f"{free['loss']:.3f}", number(free["reported"])]
    for way in (ESTIMATED, GIVEN):
        each = line[way]
        row.append(f"{each['bits_per_gaussian']:.1f}")
        row += [f"{each[loss]:.3f}" for loss in ("loss", "free_loss")]
    return [*row, ", ".join(misses_of(line))]
