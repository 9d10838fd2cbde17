"""Histograms of channels, and how well the codec's models describe them (paper, Section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.analysis.information import is_zero
from gs_codec.codecs.entropygs.models import MAX_COMPONENTS, LaplaceModel, MixtureModel, fit_mixture
from gs_codec.codecs.entropygs.section import Channel, channel_order
from gs_codec.codecs.entropygs.symbols import fit_channel
from gs_codec.coding.frequency_table import MAX_PRECISION, shannon_bits
from gs_codec.coding.quantise import ConstantQuantiser, Quantiser, quantise, quantise_positions
from gs_codec.config import Config
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Number of bars of a histogram; and the quantiles between which values are shown.
_BARS = 96
_SHOWN = (0.001, 0.999)

#: Minimum share of the code length that another component must save, as in the codec.
_WORTHWHILE = 2e-4


@dataclass(frozen=True)
class Fit:
    """A channel, its histogram, and the paper's model fitted to it.

    Attributes
    ----------
    channel : Channel
        The channel, with the quantiser of a paper profile for these values.
    model : {"laplace", "mixture", "none"}
        ``none`` for positions, which are coded as a tree, and for constant channels.
    parameters : dict
        In units of the attribute: ``median`` and ``scale`` (mean absolute deviation), or
        ``weights``, ``means``, ``sigmas``.
    edges, density : ndarray
        The histogram, ``(B + 1,)`` and ``(B,)``; empty for a constant channel.
    entropy_bits : float
        Shannon entropy per symbol.
    zeros : float
        Share of the values that are zero or nearly zero; see `is_zero`.
    ks : float or None
        Kolmogorov-Smirnov distance of the values from the model: the largest difference of
        their cumulative distributions.
    kl_bits : float or None
        Kullback-Leibler divergence of the model from the histogram of the symbols: cost of coding
        with the model beyond the entropy, bits per symbol.
    ks_nonzero : float or None
        Like `ks`, for the non-zero values only, with a Laplace distribution fitted to them.
    """

    channel: Channel
    model: str
    parameters: dict[str, Any]
    edges: NDArray[np.float64]
    density: NDArray[np.float64]
    entropy_bits: float
    zeros: float
    ks: float | None = None
    kl_bits: float | None = None
    ks_nonzero: float | None = None

    def pdf(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Density of the model at `values`."""
        from scipy.stats import laplace, norm

        if self.model == "laplace":
            return laplace.pdf(values, self.parameters["median"], self.parameters["scale"])
        return _weighted(norm.pdf, values, self.parameters)

    def as_dict(self) -> dict:
        """Convert for JSON."""
        return {
            "channel": self.channel.name,
            "group": self.channel.stream,
            "depth": self.channel.quantiser.depth,
            "model": self.model,
            "parameters": self.parameters,
            "entropy_bits": self.entropy_bits,
            "ks_distance": self.ks,
            "kl_bits": self.kl_bits,
            "zeros": self.zeros,
            "ks_distance_nonzero": self.ks_nonzero,
        }


def fits_of(scene: Scene, config: Config, progress: Progress | None = None) -> list[Fit]:
    """One fit per channel, at the bit depths of a paper profile, in stream order."""
    depths = config.resolved_depths()
    keys = channel_order(len(scene.f_rest) // 3)

    def work(key: tuple[str, int, str]) -> Fit:
        group, index, stream = key
        values = getattr(scene, group)[index]
        quantiser, scale = fit_channel(values, group, depths[stream])
        return _fit(values, Channel(group, index, stream, quantiser), scale)

    return run_all(work, keys, advance=step_counter(progress, "histograms", len(keys)))


def _fit(values: NDArray[np.float32], channel: Channel, scale: float | None) -> Fit:
    zero = is_zero(values)
    zeros = float(np.mean(zero))
    quantiser = channel.quantiser
    if isinstance(quantiser, ConstantQuantiser):
        nothing = np.zeros(0)
        return Fit(channel, "none", {"value": quantiser.value}, nothing, nothing, 0.0, zeros)
    shape = _histogram(values)
    if channel.stream == "geometry":
        counts = np.bincount(quantise_positions(values[None], [quantiser])[0])
        return Fit(channel, "none", {}, *shape, shannon_bits(counts) / len(values), zeros)
    counts = quantise(values, quantiser, np.arange(len(values)))[1]
    if scale is None:
        mixture = _mixture(counts)
        in_units = _in_units(mixture, quantiser)
        entropy, beyond = _costs(mixture, counts)
        ks = _ks_mixture(values, in_units)
        return Fit(channel, mixture.kind, in_units, *shape, entropy, zeros, ks, beyond)
    model = LaplaceModel.fit(scale, MAX_PRECISION)
    known, distance = _laplace(values)
    nonzero = _laplace(values[~zero])[1] if zeros else distance
    entropy, beyond = _costs(model, counts)
    return Fit(channel, model.kind, known, *shape, entropy, zeros, distance, beyond, nonzero)


def _costs(model: LaplaceModel | MixtureModel, counts: NDArray[np.int64]) -> tuple[float, float]:
    """Entropy per symbol, and the cost of coding with the model beyond that, bits."""
    total = int(counts.sum())
    entropy = shannon_bits(counts)
    cost = model.frequencies(len(counts)).code_length(counts)
    return entropy / total, (cost - entropy) / total


def _histogram(values: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Edges and density of a histogram without the outermost values, normalised to all values."""
    wide = values.astype(np.float64)
    low, high = np.quantile(wide, _SHOWN)
    if low == high:
        low, high = wide.min(), wide.max()
    counts, edges = np.histogram(wide, _BARS, (low, high))
    return edges, counts / (len(values) * np.diff(edges))


def _mixture(counts: NDArray[np.int64]) -> MixtureModel:
    """The mixture with the fewest components whose code length is close to the best."""
    fitted = [fit_mixture(counts, k + 1, MAX_PRECISION) for k in range(MAX_COMPONENTS)]
    costs = [model.frequencies(len(counts)).code_length(counts) for model in fitted]
    enough = min(costs) * (1 + _WORTHWHILE)
    return next(model for model, cost in zip(fitted, costs, strict=True) if cost <= enough)


def _in_units(model: MixtureModel, quantiser: Quantiser) -> dict[str, list[float]]:
    """A mixture's parameters in units of the attribute."""
    known = model.describe()
    return {
        "weights": known["weights"],
        "means": [quantiser.origin + quantiser.step * mean for mean in known["means"]],
        "sigmas": [quantiser.step * sigma for sigma in known["sigmas"]],
    }


def _weighted(
    function: Callable, values: NDArray[np.float64], known: Mapping[str, list[float]]
) -> NDArray[np.float64]:
    """The pdf or cdf of a mixture, from the function of a normal distribution."""
    parts = zip(known["weights"], known["means"], known["sigmas"], strict=True)
    return sum((w * function(values, m, s) for w, m, s in parts), np.zeros(len(values)))


def _ks_mixture(values: NDArray[np.float32], known: Mapping[str, list[float]]) -> float:
    from scipy.stats import ks_1samp, norm

    wide = values.astype(np.float64)
    return float(ks_1samp(wide, lambda x: _weighted(norm.cdf, x, known), method="asymp").statistic)


def _laplace(values: NDArray[np.float32]) -> tuple[dict[str, float], float | None]:
    """Median, mean absolute deviation, and KS distance from the Laplace distribution with these."""
    from scipy.stats import ks_1samp, laplace

    if values.size == 0:
        return {}, None
    wide = values.astype(np.float64)
    median = float(np.median(wide))
    scale = float(np.abs(wide - median).mean())
    if scale == 0.0:
        return {"median": median, "scale": scale}, None
    distance = ks_1samp(wide, laplace(median, scale).cdf, method="asymp").statistic
    return {"median": median, "scale": scale}, float(distance)
