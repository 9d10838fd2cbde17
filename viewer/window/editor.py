"""Selecting in and editing the scenes of a window: tools, steps, saving."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gs_codec
from viewer.scenes.edits import Edits, Options
from viewer.scenes.opened import Opened
from viewer.scenes.pose import moved, scale_of
from viewer.scenes.region import REGIONS
from viewer.scenes.saving import save_scene
from viewer.scenes.selecting import (
    SEEDS,
    Selecting,
    by_rule,
    in_range,
    inside_box,
    range_options,
    rule_options,
    rules,
)
from viewer.scenes.typed_paths import SAVED_SCENES
from viewer.scenes.worker import Stale
from viewer.window import dialogs
from viewer.window.dock import Dock
from viewer.window.mouse import Tool
from viewer.window.pane import Pane
from viewer.window.region_tool import RegionTool
from viewer.window.seed_tool import SeedTool
from viewer.window.shared import Host
from viewer.window.visits import Visits

#: The name of the tool that moves the camera.
NAVIGATE = "navigate"


class Editor:
    """Edits of the scenes of a window, and the tools for drags in its panes.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    dock : Dock

    Attributes
    ----------
    tools : dict of str to Tool
        Tools for drags in a pane, by name.
    tool : str
        The name of one of them, or `NAVIGATE`.
    selecting : Selecting
        How tools and rules select.
    all : list of Edits
        Edits of the scenes shown.
    number : int
        Index of the edited scene: 0 or 1.
    worker : Worker
        Runs selecting and saving, so that pictures can be drawn meanwhile.
    """

    def __init__(self, viewer: Host, visits: Visits, dock: Dock) -> None:
        self._viewer, self._visits, self._dock = viewer, visits, dock
        self.tool = NAVIGATE
        self.number = 0
        self.all: list[Edits] = []
        self._placed = np.eye(4)  # of the first scene, when `follow` was called last
        self.selecting = Selecting()
        self.worker = viewer.worker.another()
        self.tools: dict[str, Tool] = {kind: RegionTool(kind, viewer, self) for kind in REGIONS}
        self.tools |= {kind: SeedTool(kind, viewer, self) for kind in SEEDS}
        viewer.modal.cancels.append(self._cancel)

    def put(self, scenes: Sequence[Opened]) -> None:
        """Set the scenes shown; scenes shown before keep their edits."""
        self._drop()
        known = {edits.scene: edits for edits in self.all}
        self.all = [known.get(scene) or Edits(scene) for scene in scenes]
        self.number = min(self.number, max(len(scenes) - 1, 0))
        self._placed = self.all[0].placed if self.all else np.eye(4)
        self._show_drawn()
        self.mark()

    @property
    def edits(self) -> Edits | None:
        """Edits of the edited scene; None if there is none."""
        return self.all[self.number] if self.all else None

    @property
    def unsaved(self) -> list[int]:
        """Indices of scenes with unsaved edits."""
        return [k for k, edits in enumerate(self.all) if edits.unsaved]

    @property
    def rules(self) -> list[str]:
        """Rules for selecting Gaussians of the edited scene."""
        return rules(self._viewer.stage.pruned if self.number == 0 else None)

    def set_number(self, number: int) -> None:
        """Edit another scene."""
        self.number = number
        self._viewer.panel.refresh()

    # Tool

    def set_tool(self, tool: str) -> None:
        """Choose a tool by name; the same tool again switches back to moving the camera."""
        self._cancel()
        self.tool = NAVIGATE if tool == self.tool else tool
        self._viewer.stage.mouse.tool = self.tools.get(self.tool)
        self._viewer.panel.refresh()

    def choose(self, pane: Pane, chosen: NDArray[np.bool_], how: str, kept: Options = ()) -> None:
        """Edit a pane's scene, and combine a mask ``(N,)`` with its selection.

        `kept` are options of ``gs-codec convert`` that remove the Gaussians not in the mask.
        """
        self.number = self._viewer.stage.panes.index(pane)
        self.do(lambda edits: edits.select(chosen, how, ((), kept)))

    def preview(self, pane: Pane, chosen: NDArray[np.bool_], how: str) -> None:
        """Only show the selection that `choose` would make."""
        number = self._viewer.stage.panes.index(pane)
        self._viewer.stage.show_selected(number, self.all[number].combined(chosen, how))

    def resize_brush(self, way: int) -> None:
        """Make the brush a fifth smaller (-1) or larger (1)."""
        radius = round(self.selecting.radius * 1.25**way) + way
        self.selecting.radius = min(max(radius, 2), 500)
        self._viewer.panel.refresh()

    def finish(self) -> bool:
        """End the polygon; return whether one was begun."""
        return self.tool in self.tools and self.tools[self.tool].finish()

    def _drop(self) -> bool:
        return self.tool in self.tools and self.tools[self.tool].drop()

    def _cancel(self) -> bool:
        """Drop what a tool has begun, and its preview; return whether there was anything."""
        dropped = self._drop()
        self.mark()
        return dropped

    # Steps

    def do(self, step: Callable[[Edits], None]) -> None:
        """Apply a step to the edited scene, and show the result."""
        edits = self.edits
        if edits is None:
            return
        seen = edits.seen
        try:
            step(edits)
        except (gs_codec.GsCodecError, MemoryError) as error:
            self._viewer.fail(error)
            return
        self.show()
        if edits.seen is not seen:
            self._move_camera(edits.seen @ np.linalg.inv(seen))

    def _move_camera(self, matrix: NDArray) -> None:
        """Move the camera by a matrix ``(4, 4)``, as the scene was moved."""
        stage = self._viewer.stage
        if stage.pose is not None:
            distance = scale_of(matrix) * stage.navigator.distance
            stage.look_from(moved(stage.pose, matrix), distance)

    def forget(self, number: int) -> None:
        """Move what has moved with a scene back, before the scene is read again."""
        placed, seen = self.all[number].placed, self.all[number].seen
        if number == 0 and (placed != np.eye(4)).any():
            self._viewer.follow(np.linalg.inv(placed))
        if (seen != np.eye(4)).any():
            self._move_camera(np.linalg.inv(seen))

    def show(self) -> None:
        """Show the edits in the panes and the panel."""
        stage = self._viewer.stage
        for number, edits in enumerate(self.all):
            if stage.scenes[number] is not edits.scene:
                self._drop()
                stage.replace(number, edits.scene)
        self._show_drawn()
        self.mark()
        placed, before = self.all[0].placed, self._placed
        if placed is not before:
            self._placed = placed
            self._viewer.follow(placed @ np.linalg.inv(before))
        self._dock.unmark()
        self._viewer.refresh_panel()

    def _show_drawn(self) -> None:
        drawn = {edits.scene: edits.drawn for edits in self.all if edits.drawn is not None}
        self._viewer.stage.draw_only(drawn)

    def mark(self) -> None:
        """Show the selections, not previews."""
        for number, edits in enumerate(self.all):
            self._viewer.stage.show_selected(number, edits.selected)

    def select_range(self, name: str, low: float, high: float) -> None:
        """Select by a range of a quantity, inclusive; see `in_range`."""
        how, means = self.selecting.how, range_options(name, low, high)
        self.do(lambda edits: edits.select(in_range(edits.scene, name, low, high), how, means))
        self._dock.mark(name, low, high)

    def crop(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Delete the Gaussians outside a box."""
        corners = ",".join(f"{corner:.17g}" for corner in (*low, *high))
        options = (f"--crop-box={corners}",)
        self.do(lambda edits: edits.keep(inside_box(edits.scene, low, high), "crop", options))

    @property
    def box(self) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Lowest and highest coordinates ``(3,)`` of the selection; None if it is empty."""
        edits = self.edits
        if edits is None:
            return None
        centres = edits.scene.positions[edits.selected]
        centres = centres[np.isfinite(centres).all(axis=1)]
        return (centres.min(axis=0), centres.max(axis=0)) if len(centres) else None

    def select_by(self, rule: str) -> None:
        """Select by a rule of `rules`, in the background."""
        edits, viewer = self.edits, self._viewer
        if edits is None:
            return
        scene, views = edits.scene, self._visits.views
        pruned = viewer.stage.pruned if self.number == 0 else None
        cameras = None if views.chosen else views.cameras or None

        options = rule_options(rule, viewer.request.cameras if cameras else None)

        def choose(stale: Stale) -> NDArray[np.bool_]:
            progress = self.worker.progress(stale, viewer.panel.show_progress)
            return by_rule(scene, rule, pruned, cameras, progress)

        def done(chosen: NDArray[np.bool_]) -> None:
            viewer.panel.say("")
            if self.edits is edits and edits.scene is scene:
                self.do(lambda edits: edits.select(chosen, self.selecting.how, (options, ())))

        viewer.panel.say(f"looking for {rule} ...", progress=0)
        self.worker.submit("select", choose, done, viewer.fail)

    def neighbours(self, step: Callable[[Opened, NDArray[np.bool_]], NDArray[np.bool_]]) -> None:
        """Change the selection by `grown` or `shrunk`, in the background."""
        edits, viewer = self.edits, self._viewer
        if edits is None:
            return
        scene, before = edits.scene, edits.selected

        def done(chosen: NDArray[np.bool_]) -> None:
            viewer.panel.say("")
            if self.edits is edits and edits.scene is scene:
                self.do(lambda edits: edits.select(chosen))

        viewer.panel.say("looking for neighbours ...", progress=0)
        self.worker.submit("select", lambda stale: step(scene, before), done, viewer.fail)

    def stop(self) -> None:
        """Stop selecting in the background."""
        self.worker.cancel("select")
        self.mark()

    # Saving

    def ask_save(self, then: Callable[[], None] = lambda: None) -> None:
        """Ask where to save the edited scene, save it, and then call `then`."""
        if self.edits is not None:
            self._viewer.files.ask_save(
                "Save the scene",
                SAVED_SCENES,
                lambda path: self.save(path, then),
                "-edited",
                self.edits.scene.path,
            )

    def save(self, path: str, then: Callable[[], None] = lambda: None) -> None:
        """Save the edited scene in the background; the suffix selects the format."""
        edits, viewer, target = self.edits, self._viewer, Path(path)
        if edits is None:
            return
        scene, project = edits.scene, edits.project

        def write(stale: Stale) -> list[str]:
            return save_scene(scene, target, project=project)

        def done(said: list[str]) -> None:
            edits.mark_saved(scene)
            viewer.panel.say("\n".join(said))
            viewer.panel.refresh()
            then()

        viewer.panel.say(f"saving {target.name} ...")
        self.worker.submit(f"save {target}", write, done, viewer.fail)

    def ask_unsaved(self, numbers: Sequence[int], then: Callable[[], None]) -> bool:
        """Ask what to do with unsaved edits of these scenes, if any, before calling `then`.

        Returns
        -------
        bool
            Whether it asked; if not, `then` is not called.
        """
        edited = [k for k in numbers if k in self.unsaved]
        if not edited:
            return False
        self.number = edited[0]
        edits = self.all[edited[0]]

        def go_on() -> None:
            if not self.ask_unsaved(numbers, then):
                then()

        def discard() -> None:
            edits.mark_saved(edits.scene)
            go_on()

        def save() -> None:
            self.ask_save(go_on)

        text = f"{edits.scene.name} has unsaved edits."
        choices = [("Save as ...", save), ("Discard the edits", discard)]
        if edits.whole.has_changed:
            text = f"The file of {edits.scene.name} has changed: edits can no longer be saved."
            del choices[0]
        dialogs.ask_among(self._viewer.modal, "Unsaved edits", text, choices)
        return True
