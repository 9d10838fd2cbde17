"""Selected, hidden and deleted Gaussians of a scene, with undo and redo."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import gs_codec
from viewer.scenes.opened import Opened, keep

#: Ways to combine chosen Gaussians with the selection.
HOW = ("replace", "add", "remove", "intersect")

#: Maximum number of undo steps: up to 25 bytes per Gaussian in all, of its 236 with SH degree 3.
_STEPS = 100

#: Number of edited scenes cached for undo and redo.
_KEPT = 2

#: A packed mask over the file's Gaussians.
_Bits = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _State:
    """Masks over the file's Gaussians, and the step that led here."""

    step: str
    selected: _Bits
    hidden: _Bits
    deleted: _Bits


class Edits:
    """The edits of one scene.

    Masks have one element per Gaussian of `scene`, which lacks deleted Gaussians. Hidden Gaussians
    are not drawn and cannot be selected, but they are part of the scene and are saved with it.

    Parameters
    ----------
    scene : Opened
        The scene as opened or, without steps to undo, as edited before.

    Attributes
    ----------
    whole : Opened
    scene : Opened
        The scene without deleted Gaussians; `whole` itself if none are deleted.
    drawn : ndarray, shape (N,), bool, or None
        Mask of drawn Gaussians; None if none is hidden. The array object changes only with its
        contents.
    """

    def __init__(self, scene: Opened) -> None:
        self.whole, self.scene = scene.whole or scene, scene
        nothing = np.packbits(np.zeros(self.whole.count, bool))
        deleted = nothing if scene.left is None else np.packbits(~scene.left)
        self._state = _State("", nothing, nothing, deleted)
        self.drawn: NDArray[np.bool_] | None = None
        self._saved = nothing
        self._before: deque[_State] = deque(maxlen=_STEPS)
        self._after: list[_State] = []
        self._known: deque[tuple[_Bits, Opened]] = deque([(deleted, scene)], maxlen=_KEPT)

    @property
    def selected(self) -> NDArray[np.bool_]:
        """Mask ``(N,)`` of selected Gaussians."""
        return self._of_scene(self._state.selected)

    @property
    def count(self) -> int:
        """Number of selected Gaussians."""
        return int(np.unpackbits(self._state.selected).sum(dtype=np.int64))

    @property
    def hidden_count(self) -> int:
        """Number of hidden Gaussians."""
        return int(np.unpackbits(self._state.hidden).sum(dtype=np.int64))

    @property
    def unsaved(self) -> bool:
        """Whether deleted Gaussians have changed since the scene was saved."""
        return not np.array_equal(self._state.deleted, self._saved)

    @property
    def undone_next(self) -> str:
        """The step that `undo` would take back; empty if none."""
        return self._state.step if self._before else ""

    @property
    def redone_next(self) -> str:
        """The step that `redo` would repeat; empty if none."""
        return self._after[-1].step if self._after else ""

    def select(self, chosen: NDArray[np.bool_], how: str = "replace") -> None:
        """Combine a mask ``(N,)`` with the selection, as `how` (one of `HOW`) says."""
        self._do("select", selected=self.combined(chosen, how))

    def combined(self, chosen: NDArray[np.bool_], how: str) -> NDArray[np.bool_]:
        """The selection ``(N,)`` that `select` would make."""
        before = self.selected if how != "replace" else chosen
        if how == "remove":
            after = before & ~chosen
        else:
            after = before | chosen if how == "add" else before & chosen
        return after if self.drawn is None else after & self.drawn

    def select_all(self) -> None:
        """Select all Gaussians that are not hidden."""
        self.select(np.ones(self.scene.count, bool))

    def select_none(self) -> None:
        """Select nothing."""
        self.select(np.zeros(self.scene.count, bool))

    def invert(self) -> None:
        """Invert the selection."""
        self.select(~self.selected)

    def hide(self) -> None:
        """Hide the selected Gaussians, and clear the selection."""
        selected = self.selected
        hidden = self._of_scene(self._state.hidden) | selected
        self._do("hide", selected=np.zeros_like(selected), hidden=hidden)

    def show_all(self) -> None:
        """Show all hidden Gaussians."""
        self._do("show all", hidden=np.zeros(self.scene.count, bool))

    def delete(self) -> None:
        """Delete the selected Gaussians; raises like `keep`."""
        self.keep(~self.selected, "delete")

    def keep(self, kept: NDArray[np.bool_], step: str) -> None:
        """Delete all Gaussians not in the mask `kept` ``(N,)``; undo shows the name `step`.

        Raises
        ------
        gs_codec.GsCodecError
            If no Gaussians would be left.
        """
        if not kept.any():
            raise gs_codec.GsCodecError(f"{step}: no Gaussian would be left")
        hidden = self._of_scene(self._state.hidden)
        self._do(step, selected=self.selected & kept, hidden=hidden & kept, deleted=~kept)

    def undo(self) -> None:
        """Undo the last step, if any."""
        if self._before:
            self._after.append(self._state)
            self._be(self._before.pop())

    def redo(self) -> None:
        """Redo the last undone step, if any."""
        if self._after:
            self._before.append(self._state)
            self._be(self._after.pop())

    def mark_saved(self, saved: Opened) -> None:
        """Record that a scene of these edits was saved."""
        left = np.ones(self.whole.count, bool) if saved.left is None else saved.left
        self._saved = np.packbits(~left)

    def turn(self, whole: Opened) -> None:
        """Replace the whole scene by the result of `turned`, and keep the steps."""
        self.whole = whole
        self._known.clear()
        self._be(self._state)

    def _do(self, step: str, **masks: NDArray[np.bool_]) -> None:
        """Set masks ``(N,)`` of the scene as a new step, if any of them changes."""
        bits = {name: self._of_file(mask) for name, mask in masks.items()}
        bits["deleted"] = bits.get("deleted", self._state.deleted) | self._state.deleted
        before = {name: getattr(self._state, name) for name in bits}
        changed = {name: b for name, b in bits.items() if not np.array_equal(b, before[name])}
        if changed:
            self._before.append(self._state)
            self._after.clear()
            self._be(replace(self._state, step=step, **changed))

    def _be(self, state: _State) -> None:
        """Switch to a state and to the scene without its deleted Gaussians."""
        before, was = self._state, self.scene
        self._state = state
        known = [scene for deleted, scene in self._known if deleted is state.deleted]
        if known:
            self.scene = known[0]
        else:
            left = ~np.unpackbits(state.deleted, count=self.whole.count).astype(bool)
            self.scene = keep(self.whole, left)
            self._known.append((state.deleted, self.scene))
        if self.scene is not was or state.hidden is not before.hidden:
            self.drawn = ~self._of_scene(state.hidden) if self.hidden_count else None

    def _of_scene(self, bits: _Bits) -> NDArray[np.bool_]:
        """Convert a mask of the file to one ``(N,)`` of the scene."""
        mask = np.unpackbits(bits, count=self.whole.count).astype(bool)
        return mask if self.scene.left is None else mask[self.scene.left]

    def _of_file(self, mask: NDArray[np.bool_]) -> _Bits:
        """Convert a mask ``(N,)`` of the scene to one of the file."""
        whole = mask
        if self.scene.left is not None:
            whole = np.zeros(self.whole.count, bool)
            whole[self.scene.left] = mask
        return np.packbits(whole)
