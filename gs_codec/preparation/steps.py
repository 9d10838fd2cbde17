"""What preparation is asked to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gs_codec.errors import InvalidInput


@dataclass(frozen=True)
class Steps:
    """Steps of preparation, all off by default; `pipeline` has the order they run in.

    Parameters
    ----------
    prune_geometry : float
        Percent of the Gaussians to remove along each axis, those farthest from the centre
        (theta2 of the paper, Section 4.2), 0 up to 100.
    prune_importance : float
        Percent to remove by LightGaussian's importance (theta1 of the paper), 0 up to 100.
    prune_loo : float
        Percent to remove by leave-one-out error, 0 up to 100.
    max_drop : float or None
        Prune by leave-one-out error only as long as rendered views lose no more than this, dB;
        without `prune_loo`, up to it.
    optimise : int
        Iterations of Adam on all attributes of what is left.
    compact_sh : float
        Strength of SH energy compaction, 0 and up: about the mean squared error of an image value
        (0-1) that it may cost; 3e-5 is usual.
    refit_colour : int
        Conjugate-gradient steps on the colours, SH-DC and SH-AC.
    rectify : bool
        Move SH-AC outside their Laplace range to its edge, as coding by a `paper` profile does: at
        the depths of that profile, of ``paper-m`` where another codes.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    prune_geometry: float = 0.0
    prune_importance: float = 0.0
    prune_loo: float = 0.0
    max_drop: float | None = None
    optimise: int = 0
    compact_sh: float = 0.0
    refit_colour: int = 0
    rectify: bool = False

    def __post_init__(self) -> None:
        for name in ("prune_geometry", "prune_importance", "prune_loo"):
            if not 0 <= getattr(self, name) < 100:
                raise InvalidInput(f"{name} {getattr(self, name)}: expected 0 to below 100 percent")
        if 0 < self.prune_loo < 1:
            raise InvalidInput(f"prune_loo {self.prune_loo}: expected percent, half of all is 50")
        if self.max_drop is not None:
            _check("max_drop", self.max_drop, 0, 100, "0 to 100 dB")
        _check("compact_sh", self.compact_sh, 0, 1e6, "a strength of 0 or more")
        for name in ("optimise", "refit_colour"):
            _check(name, getattr(self, name), 0, 10_000_000, "a number of steps")

    @property
    def wanted(self) -> bool:
        """Whether there is anything to do."""
        return self != Steps()


def _check(name: str, value: Any, low: float, high: float, expected: str) -> None:
    if not low <= value <= high:
        raise InvalidInput(f"{name} {value}: expected {expected}")
