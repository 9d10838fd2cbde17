"""Named pipelines: steps of preparation, and how to encode the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gs_codec.config import Config, Option, changed_options
from gs_codec.plan import Steps
from gs_codec.runtime.arguments import checked

#: Half range of SH-AC, in Laplace scales. The paper gives it only in its supplement, but at 4 bits
#: its SH-AC have an entropy of 2.436 bits (Table 1). With this range, a Laplace distribution has
#: 2.48.
_LAPLACE_SCALES = 7.5


@dataclass(frozen=True)
class Preset:
    """Steps of preparation, and how to encode the result.

    Parameters
    ----------
    steps : Steps
        Steps for a `Plan`, which adds the cameras and images of the scene.
    config : Config
        Configuration for `encode`, after the steps.

    Examples
    --------
    >>> gs_codec.Preset(gs_codec.Steps(prune=30), gs_codec.Config("s")).steps.wanted
    True
    """

    steps: Steps
    config: Config

    def options(self) -> dict[str, Any]:
        """The values that differ from the defaults, by option name."""
        return changed_options(self.steps) | changed_options(self.config)


#: ``entropygs``: the paper's pipeline in its order (Sections 4.2 to 4.4). Its sizes after each step
#: imply the percentages: 760.1 to 266.0 MB by importance, theta1; 266.0 to 264.4 MB by geometry, (1
#: - theta2)^3. 6000 iterations are 20 % of a typical training.
PRESETS: Mapping[str, Preset] = {
    "entropygs": Preset(
        Steps(
            prune_importance=65.0,
            prune_geometry=0.2,
            geometry_rule="largest",
            rectify=_LAPLACE_SCALES,
            refine=6000,
            keep_refined=True,
        ),
        Config("paper-m", geometry="auto", laplace_scales=_LAPLACE_SCALES),
    )
}


@checked
def preset(name: str) -> Preset:
    """Look up a pipeline by name.

    Parameters
    ----------
    name : {"entropygs"}
        ``entropygs`` is the paper's pipeline: prune, rectify and refine, then a paper profile.

    Returns
    -------
    Preset
        Its steps and configuration; `dataclasses.replace` changes parts of them.

    Raises
    ------
    InvalidInput
        If there is no preset of this name.

    Examples
    --------
    >>> entropygs = gs_codec.preset("entropygs")
    >>> entropygs.steps.prune_importance, entropygs.steps.refine, entropygs.config.profile
    (65.0, 6000, 'paper-m')
    >>> plan = gs_codec.Plan(entropygs.steps, "cameras.json", "images")
    """
    Option("", values=tuple(PRESETS)).check("preset", name)
    return PRESETS[name]
