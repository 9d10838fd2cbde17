"""Scene to stream."""

from __future__ import annotations

from dataclasses import replace

from gs_codec.codecs.adaptive import encode as adaptive
from gs_codec.codecs.adaptive.encode import encode_adaptive
from gs_codec.codecs.adaptive.shaped import ShapedScene
from gs_codec.codecs.adaptive.step_sizes import StepSizes
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.codecs.entropygs.encode import encode_entropygs
from gs_codec.codecs.interchange import (
    RoundedScene,
    pack_by_steps,
    pack_rounded,
    round_scene,
)
from gs_codec.codecs.lossless.lossless import encode_lossless
from gs_codec.codecs.memory_limit import check_encoding
from gs_codec.coding.clean import clean_scene
from gs_codec.config import ADAPTIVE_PROFILES, EGS, LOSSLESS, Config
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene

#: Consecutive pieces of a file, and the report.
Encoded = tuple[list[bytes | memoryview], EncodeReport]


def encode_scene(
    scene: Scene,
    config: Config | None = None,
    progress: Progress | None = None,
    steps: StepSizes | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene, to `.egs` or the format that the configuration names.

    Raises InvalidInput if values are not finite and ``config.nonfinite`` is not ``drop``. Raises
    MissingTool or ToolFailed if `config` asks for G-PCC or torchac, and the program is missing or
    fails.

    Parameters
    ----------
    scene : Scene
    config : Config, optional
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.
    steps : StepSizes, optional
        Step sizes of each Gaussian, for profiles ``l``, ``m`` and ``s``; by default a rule based
        on opacity and scale is used.

    Returns
    -------
    data : bytes
    report : EncodeReport
    """
    parts, report = encode_parts(scene, config, progress, steps)
    return b"".join(parts), report


def encode_parts(
    scene: Scene,
    config: Config | None = None,
    progress: Progress | None = None,
    steps: StepSizes | None = None,
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene to the consecutive pieces of a file; see `encode_scene`."""
    config = config or Config()
    times = StageTimes()
    with using_threads(config.threads, scene.count):
        check_encoding(scene.count, config)
        with times.stage("check"):
            scene, changed = clean_scene(scene, config)
        parts, report = encode_cleaned(scene, config, times, progress, steps)
    return parts, replace(report, **changed)


def encode_cleaned(
    scene: Scene,
    config: Config,
    times: StageTimes,
    progress: Progress | None = None,
    steps: StepSizes | None = None,
    watched: Watched | None = None,
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene cleaned by `clean_scene`; see `encode_parts`.

    With profiles ``l``, ``m`` and ``s`` of an `.egs`, `watched` receives the decoded values of its
    Gaussians.
    """
    if config.format != EGS:
        parts, report = pack_by_steps(scene, config, steps, times)
    elif config.profile in ADAPTIVE_PROFILES:
        parts, report = encode_adaptive(scene, config, steps, times, progress, watched)
    elif config.profile == LOSSLESS:
        parts, report = encode_lossless(scene, config, times, progress)
    else:
        parts, report = encode_entropygs(scene, config, times, progress)
    return parts, replace(report, coarseness=config.coarseness)


def shape_scene(
    scene: Scene,
    config: Config,
    steps: StepSizes,
    times: StageTimes,
    progress: Progress | None = None,
    watched: Watched | None = None,
) -> ShapedScene | RoundedScene:
    """Quantise everything but the colours of a cleaned scene, with given step sizes.

    See `encode_cleaned` for `watched`.
    """
    if config.format != EGS:
        return round_scene(scene, config, steps, times)
    return adaptive.shape_scene(scene, config, steps, times, progress, watched)


def code_shaped(
    shaped: ShapedScene | RoundedScene, times: StageTimes, progress: Progress | None = None
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene from `shape_scene`, with its current colours."""
    if isinstance(shaped, RoundedScene):
        return pack_rounded(shaped, times)
    return adaptive.code_shaped(shaped, times, progress)
