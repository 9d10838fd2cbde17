"""Scenes from and to files; the way of the command line, which never loads Open3D."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.codec.lossless import lossless_order
from gs_codec.codec.order import order_like
from gs_codec.config import Config
from gs_codec.container.file import MAGIC
from gs_codec.errors import InvalidInput
from gs_codec.inspection import Info, inspect_bytes
from gs_codec.io.atomic import atomic_writer, check_writable
from gs_codec.io.mapped import located, opened
from gs_codec.io.ply import read_ply, write_ply
from gs_codec.metrics.attributes import Comparison, compare_scenes
from gs_codec.quantise import fit_range
from gs_codec.report import EncodeReport, Progress
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.report import PrepareReport

#: Begins the comment line that tells a decoded PLY's order: the depths it was sorted by.
_ORDER_MARK = "gs_codec order "

_UNRELATED = "neither scene was decoded from the other: compare with the original"

#: Stands for depths where the floats themselves were sorted by.
_ALL_BITS = (32, 32, 32, 32, 32, 32)


@dataclass(frozen=True)
class DecodeReport:
    """What decoding a file gave."""

    count: int
    sh_degree: int
    seconds: dict[str, float]


def encode_file(
    source: str | Path,
    target: str | Path,
    config: Config | None = None,
    progress: Progress | None = None,
    plan: Plan | None = None,
    report_folder: str | Path | None = None,
) -> EncodeReport:
    """Encode a PLY file to an `.egs` file, which appears whole or not at all.

    With a `plan`, the scene is prepared first; `report_folder` receives what that did, and what
    each stage of coding adds to it.

    Raises
    ------
    InvalidInput
        If the source cannot be used, or the target cannot be written.
    """
    config = config or Config()
    _check_target(source, target)
    start = time.perf_counter()
    scene = read_ply(source, config.extra)
    if not config.keep_order:
        scene = _without_order(scene)
    read = time.perf_counter() - start
    with located(source):
        prepared = None
        if plan is not None:
            scene, prepared = _prepare(scene, plan, report_folder, progress)
        data, report = encode_scene(scene, config, progress)
        if prepared is not None and report_folder is not None:
            _finish_report(prepared, scene, config, data, report, report_folder)
    start = time.perf_counter()
    with atomic_writer(target) as file:
        file.write(data)
    seconds = {"read": read, **report.seconds, "write": time.perf_counter() - start}
    return replace(report, seconds=seconds)


def prepare_file(
    source: str | Path,
    target: str | Path,
    plan: Plan,
    report_folder: str | Path | None = None,
    progress: Progress | None = None,
) -> PrepareReport:
    """Prepare the scene of a file and write it as ``.ply`` or ``.egs``.

    Raises
    ------
    InvalidInput
        If the source cannot be used, or the target or the report cannot be written.
    """
    _check_target(source, target)
    suffix = _format_of(target)
    scene = _without_order(read_scene(source, "keep"))
    config = Config(extra="keep")
    with located(source):
        scene, prepared = _prepare(scene, plan, report_folder, progress)
        data, report = encode_scene(scene, config)
        prepared = _finish_report(prepared, scene, config, data, report, report_folder)
    if suffix == ".ply":
        write_ply(target, scene)
    else:
        with atomic_writer(target) as file:
            file.write(data)
    return prepared


def write_scene(path: str | Path, scene: Scene, config: Config) -> None:
    """Write a scene as ``.ply`` or, encoded, as ``.egs``.

    Raises
    ------
    InvalidInput
        If the suffix is neither, or the file cannot be written.
    """
    if _format_of(path) == ".ply":
        write_ply(path, scene)
    else:
        with atomic_writer(path) as file:
            file.write(encode_scene(scene, config)[0])


def _format_of(path: str | Path) -> str:
    """The suffix of a scene to be written, which tells its format."""
    suffix = Path(path).suffix.lower()
    if suffix not in (".ply", ".egs"):
        raise InvalidInput(f"{path}: suffix '{suffix}', expected '.ply' or '.egs'")
    return suffix


def _prepare(
    scene: Scene, plan: Plan, folder: str | Path | None, progress: Progress | None
) -> tuple[Scene, PrepareReport]:
    """Prepare a scene; a folder for the report that cannot be written to is refused before."""
    # Loaded here: encoding alone does without all that draws.
    from gs_codec.preparation.pipeline import prepare_scene
    from gs_codec.rendering.images import make_folder

    if folder is not None:
        check_writable(make_folder(folder) / "report.json")
    return prepare_scene(scene, plan, progress)


def _finish_report(
    prepared: PrepareReport,
    scene: Scene,
    config: Config,
    data: bytes,
    report: EncodeReport,
    folder: str | Path | None,
) -> PrepareReport:
    """Add the stages of coding to a report and, if there is a folder, write it there."""
    from gs_codec.ablation import coding_steps
    from gs_codec.preparation.save import save_report

    coding = coding_steps(scene, config, data, report, prepared.views.held_out)
    prepared = replace(prepared, steps=(*prepared.steps, *coding))
    if folder is not None:
        save_report(folder, prepared)
    return prepared


def decode_file(
    source: str | Path,
    target: str | Path,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
) -> DecodeReport:
    """Decode an `.egs` file to a PLY file, which appears whole or not at all.

    A comment line in the PLY says in which order the Gaussians are, unless it is the
    original's, so that `compare` can match them.

    Raises
    ------
    InvalidInput
        If the source cannot be read, or the target cannot be written.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the source is not a sound `.egs` file.
    """
    _check_target(source, target)
    start = time.perf_counter()
    scene = _decode_ordered(Path(source), threads, max_bytes, progress)
    decoded = time.perf_counter()
    write_ply(target, scene)
    seconds = {"decode": decoded - start, "write": time.perf_counter() - decoded}
    return DecodeReport(scene.count, scene.sh_degree, seconds)


def read_scene(path: str | Path, extra: Literal["error", "keep", "drop"] = "error") -> Scene:
    """The scene of a PLY or `.egs` file, told apart by content; see `read_ply` for `extra`."""
    with opened(path) as data:
        is_egs = data[: len(MAGIC)] == MAGIC or Path(path).suffix.lower() == ".egs"
    return _decode_ordered(Path(path)) if is_egs else read_ply(path, extra)


def inspect_file(path: str | Path) -> Info:
    """See `inspect_bytes`; reads the first pages of the file alone."""
    with opened(path) as data, located(path):
        return inspect_bytes(data)


def compare_files(first: str | Path, second: str | Path) -> Comparison:
    """Compare two scenes; one decoded from `.egs` is matched with its original."""
    scenes, orders = [], []
    for path in (first, second):
        scenes.append(read_scene(path, "drop"))
        with located(path):
            orders.append(_order_of(scenes[-1]))
    return compare_ordered(scenes[0], scenes[1], orders)


def compare_ordered(first: Scene, second: Scene, orders: Sequence[tuple[int, ...]]) -> Comparison:
    """Compare two scenes, putting an original into the order of a decoded one."""
    if first.count == second.count and orders[0] != orders[1]:
        if all(orders):
            raise InvalidInput("both scenes were reordered, differently: compare with the original")
        if orders[1]:
            first = _put_in_order(first, second, orders[1])
        else:
            second = _put_in_order(second, first, orders[0])
        return compare_scenes(first, second, "stored order")
    return compare_scenes(first, second, "index")


def _without_order(scene: Scene) -> Scene:
    """The scene without the comment that tells its order."""
    kept = tuple(line for line in scene.comments if not line.startswith(_ORDER_MARK))
    return replace(scene, comments=kept)


def _check_target(source: str | Path, target: str | Path) -> None:
    """Refuse a target that could not be written, before the work is done."""
    check_writable(target)
    if os.path.exists(source) and os.path.exists(target) and os.path.samefile(source, target):
        raise InvalidInput(f"{target}: the source itself")


def _decode_ordered(
    path: Path,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
) -> Scene:
    with opened(path) as view, located(path):
        data = bytes(view)
        scene = decode_scene(data, threads, max_bytes, progress)
        info = inspect_bytes(data)
    if info.keeps_order:
        return scene
    depths = [channel.quantiser.depth for channel in info.channels[:6]] or _ALL_BITS
    mark = _ORDER_MARK + " ".join(str(depth) for depth in depths)
    return replace(scene, comments=(*scene.comments, mark))


def _order_of(scene: Scene) -> tuple[int, ...]:
    """Depths of x, y, z and f_dc a decoded scene was sorted by; empty if it is an original."""
    marks = [line for line in scene.comments if line.startswith(_ORDER_MARK)]
    if not marks:
        return ()
    fields = marks[-1].removeprefix(_ORDER_MARK).split()
    depths = tuple(int(field) for field in fields if field.isdigit())
    if not len(fields) == len(depths) == 6 or (max(depths) > 21 and depths != _ALL_BITS):
        raise InvalidInput(f"comment '{marks[-1]}': expected six depths")
    return depths


def _put_in_order(original: Scene, decoded: Scene, depths: tuple[int, ...]) -> Scene:
    """The original's Gaussians in the order of the stream `decoded` came from.

    Min-max quantisers keep the extremes, so the decoded scene still has the quantisers' ranges.
    """
    if depths == _ALL_BITS:
        ordered = original.take(lossless_order(original))
        if ordered.positions.tobytes() != decoded.positions.tobytes():
            raise InvalidInput(_UNRELATED)
        return ordered
    rows = (*decoded.positions, *decoded.f_dc)
    quantisers = [fit_range(r, max(d, 1)) for r, d in zip(rows, depths, strict=True)]
    ordered = original.take(order_like(original, quantisers))
    for a, b, quantiser in zip(ordered.positions, decoded.positions, quantisers[:3], strict=True):
        bound = 0.51 * quantiser.step + np.spacing(np.abs(b).max(initial=0.0))
        if (np.abs(a.astype(np.float64) - b) > bound).any():
            raise InvalidInput(_UNRELATED)
    return ordered
