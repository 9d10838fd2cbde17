"""A request to encode a scene, shared by commands, functions, batches, workers and the viewer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gs_codec.config import Config, RateTarget
from gs_codec.encoding.combinations import check_request

if TYPE_CHECKING:
    from gs_codec.edit.actions import Action
    from gs_codec.plan import Plan


@dataclass(frozen=True)
class Request:
    """How to encode a scene.

    Raises InvalidInput if an option has no effect in this combination.

    Attributes
    ----------
    config : Config
    plan : Plan or None
        Steps of preparation, and the views that guide them and the encoder.
    rate : RateTarget or None
    actions : tuple of Action
        Edits to apply first, in this order.
    by_profile : bool
        Whether values from a format that quantises are rounded to the steps of the profile.
    max_memory, max_bytes : int or None
        Limits: memory, and the scene's floats.
    dask : str or None
        Address of a scheduler whose workers divide the scene, or ``local``.
    """

    config: Config
    plan: Plan | None = None
    rate: RateTarget | None = None
    actions: tuple[Action, ...] = ()
    by_profile: bool = False
    max_memory: int | None = None
    max_bytes: int | None = None
    dask: str | None = None

    def __post_init__(self) -> None:
        check_request(self.config, self.plan, self.rate, self.actions, self.max_memory, self.dask)

    @property
    def prepares(self) -> bool:
        """Whether the scene is prepared before it is coded."""
        return self.plan is not None and self.plan.steps.wanted
