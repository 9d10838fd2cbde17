"""Result lines of ``bench run`` and ``bench peers``: scenes from their files on.

Scenes are tiled to `tile` Gaussians if given. `cameras` is where views come from, None for none;
`truth` the folder of their photographs; `width` theirs, in pixels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gs_codec.bench.beside import measure_beside, our_codecs
from gs_codec.bench.host import machine
from gs_codec.bench.measure import measure_scene
from gs_codec.bench.peers import find_peers
from gs_codec.bench.rendered import measure_quality
from gs_codec.bench.sources import held_out_views, load_scene
from gs_codec.config import ADAPTIVE_PROFILES, Config
from gs_codec.preparation.steps import Plan, Steps
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import find_cameras


def run_profiles(
    scenes: Sequence[Path],
    configs: Sequence[Config],
    tile: int | None,
    repeats: int,
    cameras: str | None,
    truth: Path | None,
    width: int | None,
) -> Iterator[dict[str, Any]]:
    """Lines of each profile by itself, without cameras and, for `l`, `m`, `s`, with them."""
    yield machine()
    for path in scenes:
        name, scene = load_scene(path, configs[0].extra, tile)
        views = find_cameras(cameras, scene, "held-out", width) if cameras else []
        for config in configs:
            yield from measure_scene(scene, name, config, repeats)
            if not cameras:
                continue
            yield measure_quality(scene, name, views, truth, config)
            if config.profile in ADAPTIVE_PROFILES:
                plan = Plan(Steps(), cameras, width=width)
                yield measure_quality(scene, name, views, truth, config, plan)


def run_peers(
    scenes: Sequence[Path],
    configs: Sequence[Config],
    tile: int | None,
    repeats: int,
    cameras: str | None,
    truth: Path | None,
    width: int | None,
) -> Iterator[dict[str, Any]]:
    """Lines of profiles and other codecs beside each other."""
    yield machine()
    extra, threads = configs[0].extra, configs[0].threads
    for path in scenes:
        name, scene = load_scene(path, extra, tile)
        views: list[Camera] = []
        plan = None
        if cameras:
            views, plan = held_out_views(cameras, scene, width)
        codecs = [*our_codecs(configs, plan), *find_peers(extra, threads)]
        yield from measure_beside(scene, name, codecs, repeats, views, truth)
