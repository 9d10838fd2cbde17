"""Choice of the model that makes a channel smallest, by real code length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.model.laplace import LaplaceModel
from gs_codec.model.mixture import MAX_COMPONENTS, MixtureModel, fit_mixture
from gs_codec.model.sent import SentModel
from gs_codec.model.table import MAX_PRECISION, FrequencyTable, shannon_bits

Model = LaplaceModel | MixtureModel | SentModel

#: Precisions of tables to try; a larger one must save this share, as it decodes slower.
_PRECISIONS = (12, 14, 15)
_WORTHWHILE = 2e-4

_MANTISSAS = (2, 3, 4, 6)

# Bytes of a model's parameters in the stream, beside its kind and precision.
_LAPLACE_BYTES = 2
_COMPONENT_BYTES = 10


@dataclass(frozen=True)
class Choice:
    """A channel's model and table, with the code lengths that it was chosen by.

    ``bits`` and ``parametric_bits`` are code lengths without parameters, ``shannon_bits``
    the entropy, each for all symbols of the channel.
    """

    model: Model
    table: FrequencyTable
    bits: float
    parametric_bits: float
    shannon_bits: float


def choose_model(
    histogram: NDArray[np.int64],
    laplace_scale: float | None,
    sent_bytes: Callable[[SentModel], int],
) -> Choice:
    """Cheapest of the parametric models and the sent tables, parameters included.

    Parameters
    ----------
    histogram : ndarray, shape (A,), int64
        Count of each symbol, not all 0.
    laplace_scale : float or None
        Mean absolute deviation in symbols for SH-AC; None tries mixtures instead.
    sent_bytes : callable
        Size of a sent table in the stream.
    """
    precisions = [p for p in _PRECISIONS if 1 << p >= 2 * histogram.size]
    parametric = _parametric_models(histogram, laplace_scale, precisions)
    candidates: list[tuple[Model, int]] = [(model, _parameter_bytes(model)) for model in parametric]
    for mantissa in _MANTISSAS:
        fitted = SentModel.fit(histogram, mantissa, MAX_PRECISION)
        size = sent_bytes(fitted)  # the same for every precision
        candidates += [(replace(fitted, precision=p), size) for p in precisions]
    priced = []
    for model, size in candidates:
        table = model.frequencies(histogram.size)
        bits = table.code_length(histogram)
        priced.append((bits + 8 * size, bits, model, table))
    enough = min(cost for cost, *_ in priced) * (1 + _WORTHWHILE)
    _, bits, model, table = min(
        (item for item in priced if item[0] <= enough),
        key=lambda item: (item[2].precision, item[0]),
    )
    parametric_bits = min(bits for _, bits, model, _ in priced[: len(parametric)])
    return Choice(model, table, bits, parametric_bits, shannon_bits(histogram))


def _parametric_models(
    histogram: NDArray[np.int64], laplace_scale: float | None, precisions: list[int]
) -> list[LaplaceModel | MixtureModel]:
    if laplace_scale is not None:
        return [LaplaceModel.fit(laplace_scale, p) for p in precisions]
    fitted = [fit_mixture(histogram, k + 1, MAX_PRECISION) for k in range(MAX_COMPONENTS)]
    return [MixtureModel(m.components, p) for m in fitted for p in precisions]


def _parameter_bytes(model: LaplaceModel | MixtureModel) -> int:
    if isinstance(model, LaplaceModel):
        return _LAPLACE_BYTES
    return 1 + _COMPONENT_BYTES * len(model.components)
