"""Compute everything that the analysis report of a scene contains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gs_codec import __version__
from gs_codec.analysis.entropy import bits_by_attribute, depths_by_group, entropy_by_group
from gs_codec.analysis.fits import Fit, fits_of
from gs_codec.analysis.information import BINS, Bins, bin_count
from gs_codec.analysis.maps import Map, maps_of, mean_by_attribute, mean_by_relation
from gs_codec.analysis.sensitivity_curves import ErrorScale, SensitivityCurves, measure_sensitivity
from gs_codec.codecs import encode_scene
from gs_codec.coding.clean import drop_nonfinite
from gs_codec.config import PROFILE_CHOICES, PROFILES, Config
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.preparation.reference_views import evenly
from gs_codec.report import SCHEMA, Progress, step_counter
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene
from gs_codec.views.find import find_cameras

#: Profile whose depths are used for histograms, models and the marks on curves.
REFERENCE = "paper-m"

#: Number of views in which sensitivities are measured.
VIEWS = 8


@dataclass(frozen=True)
class Analysis:
    """Results of analysing a scene.

    Attributes
    ----------
    name : str
        Name of the scene.
    count, sh_degree, sampled, dropped, seed, bins : int
        Gaussians, SH degree, Gaussians used for maps and fits, those with NaN or infinity, random
        seed, and bins per channel in maps.
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
    """

    name: str
    count: int
    sh_degree: int
    sampled: int
    dropped: int
    seed: int
    bins: int
    maps: dict[str, Map]
    fits: list[Fit]
    entropy: dict[str, dict[str, Any]]
    bits: dict[str, dict[str, float]]
    sensitivity: SensitivityCurves | None

    @property
    def notes(self) -> list[str]:
        """Sentences on what was left out, and why."""
        notes = []
        if self.dropped:
            notes.append(f"Left out: {counted(self.dropped, 'Gaussian')} with NaN or infinity.")
        if self.sampled < self.count:
            notes.append(
                f"Mutual information and histograms use {self.sampled:,} of "
                f"{counted(self.count, 'Gaussian')}, chosen at random (seed {self.seed}); "
                "everything else uses all Gaussians."
            )
        if self.sampled < 1000:
            notes.append(
                f"Only {counted(self.sampled, 'Gaussian')}: the statistics are unreliable."
            )
        if not self.sh_degree:
            notes.append("SH degree 0: there are no SH-AC, so their sections are absent.")
        elif self.sh_degree < 3:
            notes.append(f"SH degree {self.sh_degree}: higher bands are absent.")
        constant = [fit.channel.name for fit in self.fits if not fit.channel.quantiser.depth]
        if constant:
            notes.append(
                f"Constant channels have no histogram; their mutual information is not defined "
                f"and is given as 0: {', '.join(constant)}."
            )
        if self.sensitivity is None:
            notes.append("No cameras were given, so sensitivities were not measured.")
        return notes

    def means(self, kind: Bins) -> dict[str, dict[str, float | None]]:
        """Mean information of the channel pairs of each SH-AC map, by kind of pair."""
        return {
            name: (mean_by_attribute if "others" in name else mean_by_relation)(found, kind)
            for name, found in self.maps.items()
            if name.startswith("sh-ac")
        }

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain types, for JSON."""
        return {
            "gs_codec": __version__,
            "schema": SCHEMA,
            "input": self.name,
            "gaussians": self.count,
            "sh_degree": self.sh_degree,
            "sample": self.sampled,
            "seed": self.seed,
            "notes": self.notes,
            "mutual_information": {
                "formula": "2 I(X; Y) / (H(X) + H(Y)), less that of shuffled data: "
                "(nmi - shuffled) / (1 - shuffled)",
                "bins": self.bins,
                "binning": {
                    "counts": "equal counts",
                    "widths": "equal widths between the 0.1 % and the 99.9 % quantile",
                },
                "means": {kind: self.means(kind) for kind in BINS},
                "maps": {name: found.as_dict() for name, found in self.maps.items()},
            },
            "channels": {"profile": REFERENCE, "fits": [fit.as_dict() for fit in self.fits]},
            "entropy": self.entropy,
            "bits_by_profile": {
                profile: bits | {"total": sum(bits.values())} for profile, bits in self.bits.items()
            },
            "sensitivity": self.sensitivity and self.sensitivity.as_dict(),
        }


def analyse_scene(
    scene: Scene,
    name: str,
    cameras: str | None = None,
    width: int | None = None,
    error_scale: ErrorScale = "deviation",
    sample: int = 200_000,
    seed: int = 0,
    progress: Progress | None = None,
) -> Analysis:
    """Analyse a scene; Gaussians with NaN or infinity are dropped, and counted in a note.

    Raises InvalidInput if there is no Gaussian, or no camera.

    Parameters
    ----------
    scene : Scene
    name : str
    cameras : str, optional
        As in `find_cameras`; without cameras, sensitivities are not measured.
    width : int, optional
        Width of the views, pixels.
    error_scale : {"deviation", "mean"}
        Scale of the errors of `sensitivity`; see `gs_codec.analysis.sensitivity_curves`.
    sample : int
        Maximum Gaussians for maps and fits; entropies, bits and views use all.
    seed : int
        Random seed for sample, shuffling and noise.
    progress : callable, optional
    """
    scene, dropped = drop_nonfinite(scene, Config(nonfinite="drop"), whole=False)
    if not scene.count:
        why = f": all {dropped:,} contain NaN or infinity" if dropped else ""
        raise InvalidInput(f"{name}: no Gaussians to analyse{why}")
    views = []
    if cameras is not None:
        views = evenly(find_cameras(cameras, scene, "held-out", width, VIEWS), VIEWS)
    chosen = _sample(scene, sample, seed)
    bins = bin_count(chosen.count)
    maps = maps_of(chosen, bins, seed, progress)
    config = Config(REFERENCE)
    fits = fits_of(chosen, config, progress)
    entropy, bits = _encode(scene, progress)
    sensitivity = None
    if views:
        sensitivity = measure_sensitivity(scene, views, config, seed, error_scale, progress)
    return Analysis(
        name=name,
        count=scene.count,
        sh_degree=scene.sh_degree,
        sampled=chosen.count,
        dropped=dropped,
        seed=seed,
        bins=bins,
        maps=maps,
        fits=fits,
        entropy=entropy,
        bits=bits,
        sensitivity=sensitivity,
    )


def _sample(scene: Scene, count: int, seed: int) -> Scene:
    if scene.count <= count:
        return scene
    rng = np.random.default_rng(seed)
    return scene.take(np.sort(rng.choice(scene.count, count, replace=False)))


def _encode(
    scene: Scene, progress: Progress | None
) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, float]]]:
    """Entropies of the paper's profiles with the best models; bits by attribute of all profiles."""
    advance = step_counter(progress, "profiles", len(PROFILE_CHOICES))
    # Extra properties and comments would count as bits.
    scene = replace(scene, extra={}, comments=())
    entropy, bits = {}, {}
    for profile in PROFILE_CHOICES:
        config = Config(profile)
        report = encode(scene, Request(config))[1]
        bits[profile] = bits_by_attribute(report, scene.sh_degree)
        if profile in PROFILES:
            depths = depths_by_group(config, scene.sh_degree)
            best = encode_scene(scene, replace(config, models="best"))[1]
            entropy[profile] = {"depths": depths, "groups": entropy_by_group(best)}
        advance()
    return entropy, bits
