"""Selected, hidden, deleted and moved Gaussians of one or several scenes, with undo and redo."""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.edit.project_file import Move, Project, move_option
from viewer.scenes.opened import Opened, joined, keep

#: Ways to combine chosen Gaussians with the selection.
HOW = ("replace", "add", "remove", "intersect")

#: Maximum number of undo steps: up to 25 bytes per Gaussian in all, of its 236 with SH degree 3.
_STEPS = 100

#: Number of edited scenes cached for undo and redo.
_KEPT = 2

#: A packed mask over the file's Gaussians.
_Bits = NDArray[np.uint8]


#: Options of ``gs-codec convert``.
Options = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _State:
    """Masks over the file's Gaussians, and the step that led here.

    `placed` is the product ``(4, 4)`` of the moves of the whole scene, `seen` of those that the
    camera makes with it.
    `options` are those of ``gs-codec convert`` with the same result; None if there are none.
    `means` are the options that remove the selection, and those that remove all others.
    """

    step: str
    selected: _Bits
    hidden: _Bits
    deleted: _Bits
    moves: tuple[Move, ...] = ()
    placed: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    seen: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    names: Mapping[int, str] = field(default_factory=dict)
    order: tuple[int, ...] = ()
    options: tuple[str, ...] | None = ()
    means: tuple[Options, Options] = ((), ())


#: Fields whose change is a step.
_CHANGES = ("selected", "hidden", "deleted", "moves", "names", "order")


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
        hidden = nothing if scene.hidden is None else np.packbits(scene.hidden)
        options: Options | None = () if scene is self.whole else None
        self._state = _State("", nothing, hidden, deleted, scene.moves, options=options)
        self.drawn = ~self._of_scene(hidden) if hidden.any() else None
        # A project has masks of hidden Gaussians, and is unchanged.
        self._saved = (nothing, ()) if scene.hidden is None else (deleted, scene.moves)
        self._in_project = False
        self._before: deque[_State] = deque(maxlen=_STEPS)
        self._after: list[_State] = []
        self._known = deque([(deleted, scene.moves, scene)], maxlen=_KEPT)

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
    def now(self) -> object:
        """The present state; the same object after undo."""
        return self._state

    @property
    def placed(self) -> NDArray[np.float64]:
        """The product ``(4, 4)`` of the moves of the whole scene since it was opened."""
        return self._state.placed

    @property
    def seen(self) -> NDArray[np.float64]:
        """The product ``(4, 4)`` of the moves that the camera makes with the scene."""
        return self._state.seen

    @property
    def middle(self) -> NDArray[np.float64]:
        """Median ``(3,)`` of the finite centres that `move` would move."""
        centres = self.scene.positions[self.selected if self.count else slice(None)]
        centres = centres[np.isfinite(centres).all(axis=1)].astype(np.float64)
        return np.median(centres, axis=0) if len(centres) else np.zeros(3)

    @property
    def unsaved(self) -> bool:
        """Whether anything that is saved has changed since the scene was saved.

        A project cannot be opened after the files of its scenes have changed.
        """
        lost = self._in_project and self.whole.has_changed
        deleted, moves = (np.zeros_like(self._state.deleted), ()) if lost else self._saved
        return self._state.moves is not moves or not np.array_equal(self._state.deleted, deleted)

    @property
    def undone_next(self) -> str:
        """The step that `undo` would take back; empty if none."""
        return self._state.step if self._before else ""

    @property
    def redone_next(self) -> str:
        """The step that `redo` would repeat; empty if none."""
        return self._after[-1].step if self._after else ""

    def select(
        self,
        chosen: NDArray[np.bool_],
        how: str = "replace",
        means: tuple[Options, Options] = ((), ()),
    ) -> None:
        """Combine a mask ``(N,)`` with the selection, as `how` (one of `HOW`) says.

        `means` are options of ``gs-codec convert`` that remove the Gaussians of the mask, and that
        remove all others.
        """
        alone = how == "replace" and self.drawn is None
        means = means if alone else ((), ())
        base = replace(self._state, means=means)
        self._do("select", {"selected": self.combined(chosen, how)}, base)

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
        self.select(~self.selected, means=self._state.means[::-1])

    def hide(self) -> None:
        """Hide the selected Gaussians, and clear the selection."""
        selected = self.selected
        hidden = self._of_scene(self._state.hidden) | selected
        self._do("hide", {"selected": np.zeros_like(selected), "hidden": hidden})

    def show_all(self) -> None:
        """Show all hidden Gaussians."""
        self._do("show all", {"hidden": np.zeros(self.scene.count, bool)})

    def delete(self) -> None:
        """Delete the selected Gaussians; raises like `keep`."""
        self.keep(~self.selected, "delete", self._state.means[0])

    def keep(self, kept: NDArray[np.bool_], step: str, options: Options = ()) -> None:
        """Delete all Gaussians not in the mask `kept` ``(N,)``; undo shows the name `step`.

        `options` are those of ``gs-codec convert`` with the same result.

        Raises
        ------
        gs_codec.GsCodecError
            If no Gaussians would be left.
        """
        if not kept.any():
            raise gs_codec.GsCodecError(f"{step}: no Gaussian would be left")
        hidden = self._of_scene(self._state.hidden)
        masks = {"selected": self.selected & kept, "hidden": hidden & kept, "deleted": ~kept}
        self._do(step, masks, replace(self._state, options=self._then(options), means=((), ())))

    def move(self, matrix: NDArray[np.float64], everything: bool = False) -> None:
        """Move the selected Gaussians, or all if none is selected, by a matrix ``(4, 4)``.

        With `everything`, all are moved whatever is selected, and the camera with them.

        Raises
        ------
        gs_codec.GsCodecError
            If it shears, or scales axes differently.
        """
        state, count = self._state, self.whole.count
        seen = matrix @ state.seen if everything else state.seen
        rows = np.unpackbits(state.selected, count=count).astype(bool)
        everything = everything or not rows.any()
        rows, moves, option = rows | everything, state.moves, move_option(matrix)
        options = self._then((option,)) if everything else None
        whole = everything or self.count == self.scene.count
        placed = matrix @ state.placed if whole else state.placed
        if moves and np.array_equal(moves[-1].rows, rows):  # so that rounding does not add up
            total = matrix @ moves[-1].matrix
            if options is not None and options[-2:-1] == (move_option(moves[-1].matrix),):
                options = (*options[:-2], move_option(total))
            moves = (*moves[:-1], Move(moves[-1].rows, total))
        else:
            moves = (*moves, Move(rows, matrix))
        made = replace(
            state, moves=moves, placed=placed, seen=seen, options=options, means=((), ())
        )
        self._do("move", {}, made)

    def _then(self, options: Options) -> Options | None:
        before = self._state.options
        return (*before, *options) if options and before is not None else None

    # Several scenes

    def part(self, number: int) -> NDArray[np.bool_]:
        """Mask ``(N,)`` of the Gaussians of one of the files joined."""
        ends = np.cumsum([part.gaussians for part in self.whole.parts])
        return np.searchsorted(ends, self.scene.rows, side="right") == number

    def add(self, scene: Opened) -> None:
        """Join another scene."""
        whole, count = joined([self.whole, scene]), self.whole.count
        longer = _Longer(count, scene.count)
        before = [longer.state(state) for state in (*self._before, self._state)]
        saved = longer.mask(self._saved[0], True), longer.moves(self._saved[1])
        deleted = longer.mask(self._state.deleted, False)
        options: Options | None = () if self._state.options == () else None
        self.whole, self._saved = whole, saved
        self._known.clear()
        self._before, self._after = deque(before, maxlen=_STEPS), []
        self._be(replace(before[-1], step="add", deleted=deleted, options=options))

    def hide_part(self, number: int) -> None:
        """Hide a file's Gaussians, or show them if all are hidden."""
        part, hidden = self.part(number), self._of_scene(self._state.hidden)
        step, after = ("show", hidden & ~part) if hidden[part].all() else ("hide", hidden | part)
        self._do(step, {"selected": self.selected & ~after, "hidden": after})

    def rename(self, number: int, name: str) -> None:
        """Give a file another name."""
        state = self._state
        if name != {number: name for number, name, *_ in self.parts}[number]:
            self._do("rename", {}, replace(state, names={**state.names, number: name}))

    def raise_part(self, number: int) -> None:
        """Move a file one place up in the list, and in the scene as saved."""
        order = list(self._order)
        place = order.index(number)
        if place:
            order[place - 1 : place + 1] = order[place], order[place - 1]
            self._do("reorder", {}, replace(self._state, order=tuple(order)))

    @property
    def _order(self) -> tuple[int, ...]:
        order = self._state.order
        return (*order, *(k for k in range(len(self.whole.parts)) if k not in order))

    @property
    def parts(self) -> list[tuple[int, str, int, bool]]:
        """Number, name, Gaussians left, and whether they are hidden, of each file not removed."""
        found, hidden = [], self._of_scene(self._state.hidden)
        for number in self._order:
            part = self.part(number)
            if part.any():
                name = self._state.names.get(number, self.whole.parts[number].name)
                found.append((number, name, int(part.sum()), bool(hidden[part].all())))
        return found

    @property
    def options(self) -> Options | None:
        """Options of ``gs-codec convert`` with the same result; None if there are none."""
        return self._state.options

    @property
    def project(self) -> Project:
        """All files with these edits, in the order of the list."""
        state, parts, order = self._state, self.whole.parts, self._order
        centres = self.whole.checksums
        sources = [
            parts[k]._replace(name=state.names.get(k, parts[k].name), centres=centres[k])
            for k in order
        ]
        ends = np.cumsum([part.gaussians for part in parts])
        rows = np.concatenate([np.arange(ends[k] - parts[k].gaussians, ends[k]) for k in order])
        moves = tuple(Move(moved[rows], matrix) for moved, matrix in state.moves)
        masks = (
            np.unpackbits(bits, count=self.whole.count).astype(bool)[rows]
            for bits in (state.deleted, state.hidden)
        )
        return Project(tuple(sources), moves, *masks)

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

    def mark_saved(self, saved: Opened, in_project: bool = False) -> None:
        """Record that a scene of these edits was saved, unless another was added since."""
        if (saved.whole or saved) is not self.whole:
            return
        left = np.ones(self.whole.count, bool) if saved.left is None else saved.left
        self._saved, self._in_project = (np.packbits(~left), saved.moves), in_project

    def turn(self, whole: Opened) -> None:
        """Replace the whole scene by the result of `turned`, and keep the steps.

        Options of steps are forgotten: they describe the scene before it was turned.
        """
        self.whole = whole
        self._known.clear()
        self._before = deque(map(_without_options, self._before), maxlen=_STEPS)
        self._after = [*map(_without_options, self._after)]
        self._be(_without_options(self._state))

    def _do(
        self, step: str, masks: Mapping[str, NDArray[np.bool_]], base: _State | None = None
    ) -> None:
        """Set masks ``(N,)`` of the scene, in the state `base`, as a step, if anything changes."""
        state, bits = self._state, {name: self._of_file(mask) for name, mask in masks.items()}
        bits["deleted"] = bits.get("deleted", state.deleted) | state.deleted
        for name, after in bits.items():
            if np.array_equal(after, getattr(state, name)):
                bits[name] = getattr(state, name)
        made = replace(
            base or replace(state, means=((), ())),
            step=step,
            selected=bits.get("selected", state.selected),
            hidden=bits.get("hidden", state.hidden),
            deleted=bits["deleted"],
        )
        if any(getattr(made, name) is not getattr(state, name) for name in _CHANGES):
            self._be(made)
            self._before.append(state)
            self._after.clear()

    def _be(self, state: _State) -> None:
        """Switch to a state and to the scene without its deleted Gaussians."""
        before, was = self._state, self.scene
        key = state.deleted, state.moves
        known = [scene for *of, scene in self._known if all(map(operator.is_, of, key))]
        if known:
            self.scene = known[0]
        else:
            left = ~np.unpackbits(state.deleted, count=self.whole.count).astype(bool)
            self.scene = keep(self.whole, left, state.moves)
            self._known.append((*key, self.scene))
        self._state = state
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


def _without_options(state: _State) -> _State:
    options = () if state.options == () else None
    return replace(state, options=options, means=((), ()))


class _Longer:
    """Extends masks and states of `count` Gaussians by `more`, which earlier states lack."""

    def __init__(self, count: int, more: int) -> None:
        self._count, self._more = count, more
        self._moves: dict[int, tuple[Move, ...]] = {id(()): ()}

    def mask(self, bits: _Bits, filled: bool) -> _Bits:
        mask = np.unpackbits(bits, count=self._count).astype(bool)
        return np.packbits(np.pad(mask, (0, self._more), constant_values=filled))

    def moves(self, moves: tuple[Move, ...]) -> tuple[Move, ...]:
        """The same object for the same moves."""
        if id(moves) not in self._moves:
            self._moves[id(moves)] = tuple(
                Move(np.pad(rows, (0, self._more)), matrix) for rows, matrix in moves
            )
        return self._moves[id(moves)]

    def state(self, state: _State) -> _State:
        return replace(
            state,
            selected=self.mask(state.selected, False),
            hidden=self.mask(state.hidden, False),
            deleted=self.mask(state.deleted, True),
            moves=self.moves(state.moves),
            options=None,  # of the scenes without the one added
            means=((), ()),
        )
