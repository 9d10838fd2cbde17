"""Tell frames with the same Gaussians from frames that were each trained by itself."""

from __future__ import annotations

import numpy as np

from gs_codec.scene import Scene
from gs_codec.sequences.frame_sources import Frames

#: Pairs of frames compared to tell tracked from untracked frames, and Gaussians compared in each.
_PAIRS = 3
_SAMPLED = 256
_CANDIDATES = 20_000

#: A Gaussian is found again if fewer than this share of others are nearer to where it was.
_NEAR = 0.02

#: Share of the Gaussians that are found again in tracked frames.
_FOUND_AGAIN = 0.75


def are_tracked(frames: Frames) -> bool:
    """Whether all frames have the same Gaussians in the same order; measured in a few of them.

    Gaussians of the same number are the same if, in the next frame, few others are nearer.
    """
    firsts = np.unique(np.linspace(0, max(len(frames) - 2, 0), _PAIRS).astype(int)).tolist()
    before = frames.read(0)
    for first in firsts if len(frames) > 1 else []:
        pair = frames.read(first), frames.read(first + 1)
        if any((s.count, s.sh_degree) != (before.count, before.sh_degree) for s in pair):
            return False
        if share_found_again(*pair) < _FOUND_AGAIN:
            return False
    return True


def share_found_again(before: Scene, after: Scene) -> float:
    """Share of the Gaussians whose number is that of a near one of a similar size in another scene.

    Both scenes have the same number of Gaussians. A sample of them is compared.
    """
    rng = np.random.default_rng(0)
    sampled, others = (rng.permutation(before.count)[:n] for n in (_SAMPLED, _CANDIDATES))
    found = np.ones(len(sampled), bool)
    for group in ("positions", "log_scale"):
        first, second = (getattr(each, group).astype(np.float64) for each in (before, after))
        start, end, other = first[:, sampled], second[:, sampled], second[:, others]
        with np.errstate(all="ignore"):
            moved = ((end - start) ** 2).sum(axis=0)
            for k, (place, limit) in enumerate(zip(start.T, moved, strict=True)):
                apart = ((other - place[:, None]) ** 2).sum(axis=0)
                found[k] &= np.mean(apart < limit) < _NEAR
    return float(found.mean()) if found.size else 1.0
