"""Symbol models: Laplace, Gaussian mixture (paper, Section 4.3); selection by code length."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.exact_math import dot
from gs_codec.coding.fields import ByteReader
from gs_codec.coding.frequency_table import (
    MAX_MANTISSA,
    MAX_PRECISION,
    MIN_PRECISION,
    FrequencyTable,
    SentModel,
    encode_tables,
    normalise,
    shannon_bits,
)
from gs_codec.config import Models
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.wording import counted

MAX_COMPONENTS = 4
_ITERATIONS = 200
_TOLERANCE = 1e-8
_SMALLEST_SIGMA = 0.25

#: floor(2**60 exp(-1/8192)), from which the table of the normal distribution is computed.
_STEP_DECAY = 1152780775708076725
_TABLE_SIZE = 512  # 8 sigma in steps of 1/64

#: Table precisions to try; a larger one decodes more slowly, so it must save at least this share.
_PRECISIONS = (12, 14, 15)
_WORTHWHILE = 2e-4

_MANTISSAS = (2, 3, 4, 6)


@dataclass(frozen=True)
class LaplaceModel:
    """Laplace distribution centred on the middle symbol ``A / 2``, with open edge bins.

    Parameters
    ----------
    decay : int
        ``exp(-1 / (2 b))`` in 1/65536, b the scale in symbols; 1-65535.
    precision : int
        Base-2 logarithm of the table's sum.
    """

    kind: ClassVar[str] = "laplace"
    decay: int
    precision: int

    @classmethod
    def fit(cls, scale: float, precision: int) -> LaplaceModel:
        """Model with mean absolute deviation `scale`, in symbols."""
        decay = math.exp(-0.5 / max(scale, 1e-3))
        return cls(min(max(round(65536 * decay), 1), 65535), precision)

    def frequencies(self, alphabet: int) -> FrequencyTable:
        """Table of `alphabet` symbols, by integer arithmetic only (FORMAT.md, "Laplace")."""
        middle = alphabet // 2
        tails = []
        tail = self.decay << 15
        for _ in range(middle + 1):
            tails.append(tail)
            tail = (tail * self.decay >> 16) * self.decay >> 16
        below = [tails[middle - symbol] for symbol in range(1, middle + 1)]
        below += [(1 << 32) - tails[symbol - middle - 1] for symbol in range(middle + 1, alphabet)]
        edges = np.array([0, *below, 1 << 32], np.int64)
        return normalise(np.maximum(np.diff(edges), 1), self.precision)

    def describe(self) -> dict[str, float]:
        """Parameters in symbols, for reports."""
        return {"scale": -0.5 / math.log(self.decay / 65536)}


@cache
def normal_table() -> NDArray[np.int64]:
    """Normal CDF at ``i / 64``, i = 0..512, in 1/2**30: 2**29 at 0, 2**30 at 8 sigma.

    Integer trapezoid sums of ``exp(-z**2 / 2)``; FORMAT.md, section "Mixture".
    """
    density, decay = 1 << 60, _STEP_DECAY
    ratio = decay * decay >> 60
    sums = [0]
    for _ in range(_TABLE_SIZE):
        following = density * decay >> 60
        sums.append(sums[-1] + density + following)
        density, decay = following, decay * ratio >> 60
    return np.array([(1 << 29) + (s << 29) // sums[-1] for s in sums], np.int64)


@dataclass(frozen=True)
class Component:
    """One Gaussian: weight 1-65535; mean and sigma in 1/65536 symbol, sigma at least 1."""

    weight: int
    mean: int
    sigma: int


@dataclass(frozen=True)
class MixtureModel:
    """Mixture of 1-4 Gaussians over symbols, with open edge bins."""

    kind: ClassVar[str] = "mixture"
    components: tuple[Component, ...]
    precision: int

    def frequencies(self, alphabet: int) -> FrequencyTable:
        """Table of `alphabet` symbols, by integer arithmetic only (FORMAT.md, "Mixture")."""
        table = normal_table()
        edges = (np.arange(1, alphabet, dtype=np.int64) << 16) - (1 << 15)
        inner = np.zeros(alphabet - 1, np.int64)
        for component in self.components:
            offset = edges - component.mean
            z = np.minimum((np.abs(offset) << 16) // component.sigma, (8 << 16) - 1)
            index, part = z >> 10, z & 1023
            upper = table[index] + ((table[index + 1] - table[index]) * part >> 10)
            inner += component.weight * np.where(offset < 0, (1 << 30) - upper, upper)
        whole = sum(component.weight for component in self.components) << 30
        cumulative = np.concatenate([[0], inner >> 16, [whole >> 16]])
        return normalise(np.maximum(np.diff(cumulative), 1), self.precision)

    def describe(self) -> dict[str, list[float]]:
        """Weights (sum 1), means and sigmas in symbols, for reports."""
        total = sum(c.weight for c in self.components)
        return {
            "weights": [c.weight / total for c in self.components],
            "means": [c.mean / 65536 for c in self.components],
            "sigmas": [c.sigma / 65536 for c in self.components],
        }


@kernel
def _expectation_maximisation(histogram, weights, means, sigmas, spread):
    """EM on bin centres, in place; components that vanish get weight 0."""
    count = weights.size
    mass = np.zeros(count)
    first = np.zeros(count)
    second = np.zeros(count)
    density = np.zeros(count)
    total = histogram.sum()
    before = -np.inf
    for _ in range(_ITERATIONS):
        mass[:] = first[:] = second[:] = 0.0
        likelihood = 0.0
        for symbol in range(histogram.size):
            if histogram[symbol] == 0:
                continue
            whole = 0.0
            for k in range(count):
                z = (symbol - means[k]) / sigmas[k]
                density[k] = weights[k] / sigmas[k] * math.exp(-0.5 * z * z)
                whole += density[k]
            if whole <= 1e-300:
                continue
            likelihood += histogram[symbol] * math.log(whole)
            for k in range(count):
                share = histogram[symbol] * density[k] / whole
                offset = symbol - means[k]
                mass[k] += share
                first[k] += share * offset
                second[k] += share * offset * offset
        for k in range(count):
            weights[k] = mass[k] / total
            if mass[k] < 1e-6:
                sigmas[k] = spread
                continue
            shift = first[k] / mass[k]
            variance = second[k] / mass[k] - shift * shift
            means[k] += shift
            sigmas[k] = math.sqrt(max(variance, _SMALLEST_SIGMA * _SMALLEST_SIGMA))
        if likelihood - before < _TOLERANCE * total:
            break
        before = likelihood


def fit_mixture(histogram: NDArray[np.int64], count: int, precision: int) -> MixtureModel:
    """Mixture of `count` Gaussians by expectation maximisation on the histogram."""
    symbols = np.arange(histogram.size)
    total = histogram.sum()
    mean = dot(histogram, symbols) / total
    spread = math.sqrt(max(dot(histogram, (symbols - mean) ** 2) / total, _SMALLEST_SIGMA**2))
    cumulative = np.cumsum(histogram)
    quantiles = [(2 * k + 1) * total / (2 * count) for k in range(count)]
    means = np.searchsorted(cumulative, quantiles).astype(np.float64)
    weights = np.full(count, 1.0 / count)
    sigmas = np.full(count, max(spread / count, _SMALLEST_SIGMA))
    _expectation_maximisation(histogram, weights, means, sigmas, spread)
    components = tuple(
        Component(max(round(65535 * w), 1), round(65536 * m), max(round(65536 * s), 1))
        for w, m, s in zip(weights, means, sigmas, strict=True)
    )
    return MixtureModel(components, precision)


Model = LaplaceModel | MixtureModel | SentModel

#: Model classes by their number in a file.
_MODELS = (LaplaceModel, MixtureModel, SentModel)
_HEAD = "BB"  # kind, precision


def pack_model(model: Model) -> bytes:
    """Serialise a model; the weights of a `SentModel` are stored separately."""
    head = struct.pack(_HEAD, _MODELS.index(type(model)), model.precision)
    if isinstance(model, LaplaceModel):
        return head + struct.pack("<H", model.decay)
    if isinstance(model, MixtureModel):
        packed = [struct.pack("<HII", c.weight, c.mean, c.sigma) for c in model.components]
        return head + struct.pack("<B", len(packed)) + b"".join(packed)
    return head + struct.pack("<B", model.mantissa)


def unpack_model(reader: ByteReader, depth: int, where: str) -> Model:
    """Invert `pack_model` for symbols of `depth` bits; a `SentModel` gets no weights."""
    kind, precision = reader.unpack(_HEAD)
    if kind >= len(_MODELS) or not max(MIN_PRECISION, depth) <= precision <= MAX_PRECISION:
        raise CorruptStream(f"{where}: model {kind} of precision {precision}")
    if kind == 0:
        decay = reader.unpack("H")[0]
        if decay == 0:
            raise CorruptStream(f"{where}: Laplace decay 0")
        return LaplaceModel(decay, precision)
    number = reader.unpack("B")[0]
    if kind == 1:
        if not 1 <= number <= MAX_COMPONENTS:
            raise CorruptStream(f"{where}: {counted(number, 'component')}")
        components = tuple(Component(*reader.unpack("HII")) for _ in range(number))
        if any(c.weight == 0 or c.sigma == 0 for c in components):
            raise CorruptStream(f"{where}: a component of weight or sigma 0")
        return MixtureModel(components, precision)
    if number > MAX_MANTISSA:
        raise CorruptStream(f"{where}: mantissa of {counted(number, 'bit')}")
    return SentModel(np.zeros(0, np.int64), number, precision)


def model_bytes(model: Model) -> int:
    """Bytes of a model's parameters in a file; for a sent table, as if it were the only one."""
    size = len(pack_model(model)) - struct.calcsize(_HEAD)
    if isinstance(model, SentModel):
        size += len(encode_tables([model.weights], [model.mantissa]))
    return size


@dataclass(frozen=True)
class Choice:
    """A channel's model and table, with the code lengths that it was selected by.

    The code lengths cover all symbols of the channel, without parameters.
    """

    model: Model
    table: FrequencyTable
    bits: float
    parametric_bits: float
    shannon_bits: float


def choose_model(
    histogram: NDArray[np.int64], laplace_scale: float | None, models: Models
) -> Choice:
    """Choose the cheapest of the allowed models, parameters included.

    Parameters
    ----------
    histogram : ndarray, shape (A,), int64
        Count of each symbol, not all 0.
    laplace_scale : float or None
        Mean absolute deviation in symbols for SH-AC; None tries mixtures instead.
    models : {"parametric", "table", "best"}
        Which models to try: distributions, sent tables, or both.
    """
    fitted: list[Model] = []
    if models != "table":
        fitted += _parametric_models(histogram, laplace_scale)
    if models != "parametric":
        fitted += [SentModel.fit(histogram, mantissa, MAX_PRECISION) for mantissa in _MANTISSAS]
    precisions = [p for p in _PRECISIONS if 1 << p >= 2 * histogram.size]
    priced = []
    for each in fitted:
        size = model_bytes(each)
        for precision in precisions:
            model = replace(each, precision=precision)
            table = model.frequencies(histogram.size)
            bits = table.code_length(histogram)
            priced.append((bits + 8 * size, bits, model, table))
    enough = min(cost for cost, *_ in priced) * (1 + _WORTHWHILE)
    _, bits, model, table = min(
        (item for item in priced if item[0] <= enough),
        key=lambda item: (item[2].precision, item[0]),
    )
    parametric = [b for _, b, each, _ in priced if not isinstance(each, SentModel)]
    return Choice(model, table, bits, min(parametric, default=bits), shannon_bits(histogram))


def _parametric_models(histogram: NDArray[np.int64], laplace_scale: float | None) -> list[Model]:
    if laplace_scale is not None:
        return [LaplaceModel.fit(laplace_scale, MAX_PRECISION)]
    return [fit_mixture(histogram, k + 1, MAX_PRECISION) for k in range(MAX_COMPONENTS)]
