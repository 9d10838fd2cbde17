"""What each part of profiles `l`, `m` and `s` saves: the codec with that part taken out.

A part is taken out by putting a simpler function into the encoder (and into the decoder, where
the format has the part) for one encoding, so that the codec has no switches of its own for this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.codec.guidance import Guidance
from gs_codec.config import Config
from gs_codec.lattice.fit import features
from gs_codec.lattice.fixed import to_float
from gs_codec.lattice.plan import ACTIVITIES, COLOUR_SHIFTS, ENERGIES
from gs_codec.metrics.views import compare_views
from gs_codec.model.contexts import ContextTables
from gs_codec.planned import guide_of
from gs_codec.preparation.pipeline import Plan
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene

_ENCODER = "gs_codec.codec.lattice_encode"
_ARRANGE = "gs_codec.codec.lattice_arrange"
_BLOCKS = "gs_codec.codec.lattice_blocks"
_DECODER = "gs_codec.codec.lattice_decode"
_GUIDE = "gs_codec.preparation.guide"

#: By what steps are coarser in the line that tells what a decibel costs.
_COARSER = 1.2

Maker = Callable[[Any], Any]


@dataclass(frozen=True)
class Part:
    """A part, and what makes the stand-ins for functions of the codec, by their place.

    What is not ``decodable`` costs bits alone: decoded values would be the same. Steps are
    multiplied by ``coarseness``.
    """

    name: str
    instead: Mapping[str, Maker] = field(default_factory=dict)
    decodable: bool = True
    coarseness: float = 1.0


def measure_parts(
    scene: Scene,
    name: str,
    cameras: Sequence[Camera],
    config: Config,
    plan: Plan | None = None,
) -> Iterator[dict[str, Any]]:
    """A result line for the whole codec, one for coarser steps, and one without each part.

    With a `plan`, the scene is encoded by its views.

    ``saved_bits`` are the bits of a Gaussian that the part saves at equal PSNR of the decoded
    scene's views against the scene's own; what coarser steps save, and lose, tells what a
    decibel costs.
    """
    guide = guide_of(scene, plan, config) if plan is not None else None
    seen: list[Guidance] = []

    def guide_once(clean: Scene) -> Guidance:
        if not seen:
            seen.append(guide(clean))  # type: ignore[misc]
        return seen[0]

    points: list[tuple[float, float]] = []
    for part in _parts(scene, by_views=guide is not None):
        changed = replace(config, coarseness=config.coarseness * part.coarseness)
        points.append(_measure(scene, cameras, changed, part, guide_once if guide else None))
        (whole, best), (coarse, worse) = points[0], points[min(1, len(points) - 1)]
        decibel = (whole - coarse) / (best - worse) if best > worse else 0.0
        bits, psnr = points[-1]
        yield {
            "kind": "part",
            "scene": name,
            "profile": config.profile,
            "by_views": guide is not None,
            "without": part.name,
            "bits_per_gaussian": bits,
            "psnr": psnr,
            "saved_bits": bits - whole + decibel * (best - psnr),
        }


def _measure(
    scene: Scene,
    cameras: Sequence[Camera],
    config: Config,
    part: Part,
    guide: Callable[[Scene], Guidance] | None,
) -> tuple[float, float]:
    """Bits of a Gaussian and mean PSNR without a part."""
    with ExitStack() as stack:
        for place, make in part.instead.items():
            module, name = place.rsplit(".", 1)
            original = getattr(import_module(module), name)
            stack.enter_context(patch(place, make(original)))
        data, _ = encode_scene(scene, config, guide=guide)
        decoded = decode_scene(data) if part.decodable else None
    bits = 8 * len(data) / max(scene.count, 1)
    if decoded is None:
        decoded = decode_scene(encode_scene(scene, config, guide=guide)[0])
    return bits, compare_views(scene, decoded, cameras, device="cpu").mean.between.psnr


def _parts(scene: Scene, by_views: bool) -> list[Part]:
    return [
        Part("nothing"),
        Part("steps as fine", coarseness=_COARSER),
        *(_guided_parts() if by_views else _blind_parts(scene)),
        Part("contexts of SH-AC by energy", {f"{_ENCODER}.share_tables": _without_energies}),
        Part("contexts of all else", {f"{_ENCODER}.share_tables": _without_others}),
        Part("prediction of SH-DC", {f"{_BLOCKS}.code_colours": lambda _: _code_plainly}, False),
        Part("coarse positions where less is seen", {f"{_ARRANGE}._grid": _with_all_bits}),
        Part(
            "longest axis first, quaternion nearest to the identity",
            {f"{place}.sort_axes": lambda _: _leave_axes for place in (_ARRANGE, _BLOCKS)},
        ),
    ]


def _guided_parts() -> list[Part]:
    def constant(rules: dict[str, list[int]]) -> dict[str, list[int]]:
        return {name: [0] for name in rules}

    return [
        Part("rules of steps", {"gs_codec.lattice.fit._FEATURES": constant}),
        Part("a class of its own for colour", {f"{_ARRANGE}.fit_steps": _with_one_class}),
        Part("SH compaction", {f"{_GUIDE}.compact_sh": lambda _: _leave_scene}),
        Part("refit of colours", {f"{_GUIDE}.refit_colour": lambda _: _leave_scene}),
    ]


def _blind_parts(scene: Scene) -> list[Part]:
    sorted_scales = -np.sort(-scene.log_scale.astype(np.float64), axis=0)
    mean = features(scene.opacity[0], sorted_scales).mean(axis=1) if scene.count else np.zeros(5)

    def flat(original: Any) -> Any:
        def blind_coefficients(*arguments: Any) -> dict[str, NDArray[np.float64]]:
            found = original(*arguments)
            return {name: np.eye(5)[0] * (row @ mean) for name, row in found.items()}

        return blind_coefficients

    in_rgb: dict[str, Maker] = {
        f"{_BLOCKS}.take_colours": lambda _: _take_plainly,
        f"{_BLOCKS}.to_ycocg": lambda _: np.float64,
        f"{_DECODER}.fill_colours": lambda _: _fill_plainly,
        f"{_DECODER}.from_ycocg": lambda _: np.float32,
    }
    return [
        Part("rules of steps", {f"{_ARRANGE}.blind_coefficients": flat}),
        Part("diffusion of errors of SH-AC", {f"{_ENCODER}.colour_block": _without_diffusion}),
        Part("Y, Co, Cg", in_rgb),
    ]


def _without_diffusion(original: Any) -> Any:
    return lambda arranged, shaped, diffusing: original(arranged, shaped, diffusing=False)


def _without_energies(original: Any) -> Any:
    return lambda counts: _merge(counts) if len(counts) == len(ENERGIES) else original(counts)


def _without_others(original: Any) -> Any:
    return lambda counts: original(counts) if len(counts) == len(ENERGIES) else _merge(counts)


def _merge(counts: NDArray[np.int64]) -> ContextTables:
    return ContextTables(np.zeros(len(counts), np.int64), counts.sum(axis=0, keepdims=True))


def _with_all_bits(original: Any) -> Any:
    def grid(*arguments: Any) -> Any:
        found, rule = original(*arguments)
        return found, replace(rule, limit=0)

    return grid


def _with_one_class(original: Any) -> Any:
    def fit_steps(*arguments: Any) -> Any:
        steps = original(*arguments)
        colour = steps.coefficients["colour"].copy()
        colour[0] += np.mean(steps.colour_class.astype(float) - steps.shape_class)
        return replace(
            steps,
            colour_class=steps.shape_class,
            coefficients={**steps.coefficients, "colour": colour},
        )

    return fit_steps


def _leave_scene(scene: Scene, *_: Any, **__: Any) -> tuple[Scene, None]:
    return scene, None


def _leave_axes(log_scale: NDArray, rot: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    order = np.repeat(np.arange(3, dtype=np.uint8)[:, None], log_scale.shape[1], axis=1)
    unit = rot / np.linalg.norm(rot.astype(np.float64), axis=0)
    return order, log_scale.astype(np.float64), np.where(unit[0] < 0, -unit[1:], unit[1:])


def _code_plainly(_: Any, colours: NDArray, unit: int, shifts: NDArray) -> tuple:
    levels = np.floor(colours / (unit << shifts) + 0.5).astype(np.int32).T
    contexts = ACTIVITIES * np.minimum(shifts, COLOUR_SHIFTS - 1)
    channels = COLOUR_SHIFTS * ACTIVITIES * np.arange(3)
    return np.ascontiguousarray(levels), contexts[:, None] + channels, colours


def _take_plainly(
    planes: NDArray, members: NDArray, units: NDArray, shifts: NDArray, limit: float
) -> tuple[NDArray[np.float32], int]:
    values = np.clip(planes[:, :, members], -limit, limit) / to_float(units[:, None] << shifts)
    return values.reshape(3 * len(units), -1).astype(np.float32), 0


def _fill_plainly(
    levels: NDArray, units: NDArray, shifts: NDArray, _: float, out: NDArray[np.float32]
) -> bool:
    out[:] = levels * to_float(units[:, None] << shifts)
    return True
