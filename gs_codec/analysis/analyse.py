"""Compute everything that the analysis report of a scene contains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec import __version__
from gs_codec.analysis.entropy import bits_by_attribute, depths_by_group, entropy_by_group
from gs_codec.analysis.fits import Fit, fits_of
from gs_codec.analysis.information import bin_count
from gs_codec.analysis.maps import Map, maps_of, mean_by_attribute, mean_by_relation
from gs_codec.analysis.sensitivity import SensitivityCurves, measure_sensitivity
from gs_codec.codecs import encode_scene
from gs_codec.coding.clean import drop_nonfinite
from gs_codec.config import PROFILE_CHOICES, PROFILES, Config
from gs_codec.errors import InvalidInput
from gs_codec.preparation.reference_views import evenly
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import find_cameras
from gs_codec.report import Progress, step_counter
from gs_codec.scene import Scene

#: The profile whose depths are used for histograms, models and the marks on curves.
REFERENCE = "paper-m"

#: Number of views in which sensitivities are measured.
VIEWS = 8


@dataclass(frozen=True)
class Options:
    """Options of an analysis.

    Parameters
    ----------
    cameras : path, "auto", or sequence of Camera, optional
        As for `find_cameras`; without cameras, sensitivities are not measured.
    width : int, optional
        Width of the views, pixels.
    sample : int
        Most Gaussians to use for maps and fits, 2 or more. Default 200,000.
    seed : int
        Random seed for sample, shuffling and noise, 0 or more. Default 0.

    Raises
    ------
    InvalidInput
        If a value is outside its range.
    """

    cameras: str | Path | Sequence[Camera] | None = None
    width: int | None = None
    sample: int = 200_000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.sample < 2:
            raise InvalidInput(f"sample {self.sample}: expected at least 2 Gaussians")
        if self.seed < 0:
            raise InvalidInput(f"seed {self.seed}: expected 0 or more")


@dataclass(frozen=True)
class Analysis:
    """Results of analysing a scene.

    Attributes
    ----------
    name : str
        Name of the scene.
    count, sh_degree, sampled, seed, bins : int
        Gaussians, SH degree, Gaussians used for maps and fits, random seed, and bins per channel
        in maps.
    maps : dict of str to Map
        See `maps_of`.
    fits : list of Fit
        One for each channel.
    entropy : dict of str to dict
        For each paper profile, its depths and `entropy_by_group`.
    bits : dict of str to dict of str to float
        For each profile, `bits_by_attribute`.
    sensitivity : SensitivityCurves or None
        Only with cameras.
    notes : tuple of str
        What was left out, and why.
    """

    name: str
    count: int
    sh_degree: int
    sampled: int
    seed: int
    bins: int
    maps: dict[str, Map]
    fits: list[Fit]
    entropy: dict[str, dict[str, Any]]
    bits: dict[str, dict[str, float]]
    sensitivity: SensitivityCurves | None
    notes: tuple[str, ...]

    def means(self) -> dict[str, dict[str, float | None]]:
        """Mean information of the channel pairs of each SH-AC map, by kind of pair."""
        return {
            name: mean_by_attribute(found) if "others" in name else mean_by_relation(found)
            for name, found in self.maps.items()
            if name.startswith("sh-ac")
        }

    def as_dict(self) -> dict[str, Any]:
        """The same as plain types, for JSON."""
        return {
            "gs_codec": __version__,
            "scene": self.name,
            "gaussians": self.count,
            "sh_degree": self.sh_degree,
            "sample": self.sampled,
            "seed": self.seed,
            "notes": self.notes,
            "mutual_information": {
                "formula": "2 I(X; Y) / (H(X) + H(Y)), less that of shuffled data: "
                "(nmi - shuffled) / (1 - shuffled)",
                "bins": self.bins,
                "binning": "equal mass",
                "means": self.means(),
                "maps": {name: found.as_dict() for name, found in self.maps.items()},
            },
            "channels": {"profile": REFERENCE, "fits": [fit.as_dict() for fit in self.fits]},
            "entropy": self.entropy,
            "bits_per_gaussian": {
                profile: bits | {"total": sum(bits.values())} for profile, bits in self.bits.items()
            },
            "sensitivity": self.sensitivity and self.sensitivity.as_dict(),
        }


def analyse_scene(
    scene: Scene, name: str, options: Options | None = None, progress: Progress | None = None
) -> Analysis:
    """Analyse a scene; Gaussians with NaN or infinity are left out, and a note says so.

    Maps and fits use a sample of the Gaussians; entropies, bits and views use all of them.

    Raises
    ------
    InvalidInput
        If there is no Gaussian, or no camera.
    """
    options = options or Options()
    scene, dropped = drop_nonfinite(scene, Config(nonfinite="drop"))
    if not scene.count:
        left = f"all {dropped:,} hold NaN or infinity" if dropped else "0"
        raise InvalidInput(f"{name}: Gaussians: {left}, expected at least 1 to analyse")
    cameras = _cameras(scene, options)
    sample = _sample(scene, options)
    bins = bin_count(sample.count)
    maps = maps_of(sample, bins, options.seed, progress)
    config = Config(REFERENCE)
    fits = fits_of(sample, config, progress)
    entropy, bits = _encode(scene, progress)
    sensitivity = None
    if cameras:
        sensitivity = measure_sensitivity(scene, cameras, config, options.seed, progress)
    return Analysis(
        name=name,
        count=scene.count,
        sh_degree=scene.sh_degree,
        sampled=sample.count,
        seed=options.seed,
        bins=bins,
        maps=maps,
        fits=fits,
        entropy=entropy,
        bits=bits,
        sensitivity=sensitivity,
        notes=_notes(scene, dropped, sample, fits, options),
    )


def _cameras(scene: Scene, options: Options) -> list[Camera]:
    if options.cameras is None:
        return []
    found = find_cameras(options.cameras, scene, "held-out", options.width, VIEWS)
    return evenly(found, VIEWS)


def _sample(scene: Scene, options: Options) -> Scene:
    if scene.count <= options.sample:
        return scene
    rng = np.random.default_rng(options.seed)
    return scene.take(np.sort(rng.choice(scene.count, options.sample, replace=False)))


def _encode(
    scene: Scene, progress: Progress | None
) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, float]]]:
    """Entropies of the paper's profiles, and bits per attribute of all profiles."""
    advance = step_counter(progress, "profiles", len(PROFILE_CHOICES))
    # Extra properties and comments would count as bits.
    scene = replace(scene, extra={}, comments=())
    entropy, bits = {}, {}
    for profile in PROFILE_CHOICES:
        config = Config(profile)
        report = encode_scene(scene, config)[1]
        bits[profile] = bits_by_attribute(report, scene.sh_degree)
        if profile in PROFILES:
            depths = depths_by_group(config, scene.sh_degree)
            entropy[profile] = {"depths": depths, "groups": entropy_by_group(report)}
        advance()
    return entropy, bits


def _notes(
    scene: Scene, dropped: int, sample: Scene, fits: list[Fit], options: Options
) -> tuple[str, ...]:
    """Notes that a reader of the numbers should know."""
    notes = []
    if dropped:
        notes.append(f"{dropped:,} Gaussians with NaN or infinity were left out.")
    if sample.count < scene.count:
        notes.append(
            f"Mutual information and histograms use {sample.count:,} of the {scene.count:,} "
            f"Gaussians, chosen at random (seed {options.seed}); all else uses every Gaussian."
        )
    if sample.count < 1000:
        notes.append(f"{sample.count:,} Gaussians are few: the statistics are unreliable.")
    if not scene.sh_degree:
        notes.append("SH degree 0: there are no SH-AC, so their sections are absent.")
    elif scene.sh_degree < 3:
        notes.append(f"SH degree {scene.sh_degree}: higher bands are absent.")
    constant = [fit.channel.name for fit in fits if not fit.channel.quantiser.depth]
    if constant:
        notes.append(
            f"Constant channels have no histogram; their mutual information is not defined and "
            f"is given as 0: {', '.join(constant)}."
        )
    if options.cameras is None:
        notes.append("No cameras were given (--cameras), so sensitivities were not measured.")
    return tuple(notes)
