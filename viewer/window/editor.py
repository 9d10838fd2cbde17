"""Selecting in and editing the scenes of a window: tools, steps, saving."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

import gs_codec
from viewer.scenes.appearance import which_drawn
from viewer.scenes.edits import Edits
from viewer.scenes.opened import Opened
from viewer.scenes.region import REGIONS, Region, in_region
from viewer.scenes.saving import save_scene
from viewer.scenes.selecting import by_rule, in_range, inside_box, rules
from viewer.scenes.typed_paths import SAVED_SCENES
from viewer.window import dialogs
from viewer.window.dock import Dock
from viewer.window.mouse import Place
from viewer.window.pane import Pane
from viewer.window.shared import Host
from viewer.window.visits import Visits
from viewer.window.worker import Stale

#: Tools for drags in a pane: the first moves the camera, the others draw a region.
TOOLS = ("navigate", *REGIONS)


class Editor:
    """Edits of the scenes of a window, and the tool that draws regions.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    dock : Dock

    Attributes
    ----------
    tool : str
        One of `TOOLS`.
    all : list of Edits
        Edits of the scenes shown.
    number : int
        Index of the edited scene: 0 or 1.
    worker : Worker
        Runs selecting and saving, so that pictures can be drawn meanwhile.
    """

    def __init__(self, viewer: Host, visits: Visits, dock: Dock) -> None:
        self._viewer, self._visits, self._dock = viewer, visits, dock
        self.tool = "navigate"
        self.number = 0
        self.all: list[Edits] = []
        self._pane: Pane | None = None
        self._region: Region | None = None
        self._how = "replace"
        self.worker = viewer.worker.another()

    def put(self, scenes: Sequence[Opened]) -> None:
        """Set the scenes shown; scenes shown before keep their edits."""
        self._pane = self._region = None
        known = {edits.scene: edits for edits in self.all}
        self.all = [known.get(scene) or Edits(scene) for scene in scenes]
        self.number = min(self.number, max(len(scenes) - 1, 0))
        self._mark()

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
        """Choose a tool of `TOOLS`; the same tool again switches back to the first."""
        self._drop()
        self.tool = TOOLS[0] if tool == self.tool else tool
        self._viewer.stage.mouse.tool = None if self.tool == TOOLS[0] else self
        self._viewer.panel.refresh()

    def begin(self, pane: Pane, at: Place, event: gui.MouseEvent) -> None:
        """Begin drawing a region in a pane; see `Tool`."""
        self._drop()
        added = event.is_modifier_down(gui.KeyModifier.SHIFT)
        removed = event.is_modifier_down(gui.KeyModifier.CTRL)
        self._how = "add" if added else "remove" if removed else "replace"
        self._pane, self._region = pane, Region(self.tool, at)

    def move(self, at: Place) -> None:
        """Extend the region, within the pane."""
        stage, pane, region = self._viewer.stage, self._pane, self._region
        if pane is None or region is None or stage.pose is None:
            return
        frame = pane.widget.frame
        left, top = stage.place(pane, frame.x, frame.y)
        ends = (left, top), (left + frame.width - 1, top + frame.height - 1)
        x, y = np.clip(at, *ends).tolist()
        region.extend((x, y))
        line = np.asarray(region.corners)
        pane.show_lines("region", [line], stage.pose, *stage.picture_size)

    def end(self) -> None:
        """Select the Gaussians in the region; a click alone selects nothing."""
        stage, pane, region = self._viewer.stage, self._pane, self._region
        self._drop()
        if pane is None or region is None or stage.pose is None or pane not in stage.visible:
            return
        self.number = stage.panes.index(pane)
        edits = self.all[self.number]
        drawn = which_drawn(edits.scene, stage.shown.look(edits.scene))
        chosen = in_region(edits.scene, stage.pose, stage.picture_size, region.corners, drawn)
        self.do(lambda edits: edits.select(chosen, self._how))

    def _drop(self) -> None:
        """Drop the unfinished region, if any."""
        stage = self._viewer.stage
        if self._pane is not None and stage.pose is not None:
            self._pane.show_lines("region", [], stage.pose, *stage.picture_size)
        self._pane = self._region = None

    # Steps

    def do(self, step: Callable[[Edits], None]) -> None:
        """Apply a step to the edited scene, and show the result."""
        edits = self.edits
        if edits is None:
            return
        try:
            step(edits)
        except gs_codec.GsCodecError as error:
            self._viewer.fail(error)
            return
        self.show()

    def show(self) -> None:
        """Show the edits in the panes and the panel."""
        stage = self._viewer.stage
        for number, edits in enumerate(self.all):
            if stage.scenes[number] is not edits.scene:
                stage.replace(number, edits.scene)
        stage.draw_only({e.scene: e.drawn for e in self.all if e.drawn is not None})
        self._mark()
        self._dock.unmark()
        self._viewer.refresh_panel()

    def _mark(self) -> None:
        for number, edits in enumerate(self.all):
            self._viewer.stage.show_selected(number, edits.selected)

    def select_range(self, name: str, low: float, high: float) -> None:
        """Select by a range of a quantity, inclusive; see `in_range`."""
        self.do(lambda edits: edits.select(in_range(edits.scene, name, low, high)))
        self._dock.mark(name, low, high)

    def crop(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Delete the Gaussians outside a box."""
        self.do(lambda edits: edits.keep(inside_box(edits.scene, low, high), "crop"))

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

        def choose(stale: Stale) -> NDArray[np.bool_]:
            progress = self.worker.progress(stale, viewer.panel.show_progress)
            return by_rule(scene, rule, pruned, cameras, progress)

        def done(chosen: NDArray[np.bool_]) -> None:
            viewer.panel.say("")
            if self.edits is edits and edits.scene is scene:
                self.do(lambda edits: edits.select(chosen))

        viewer.panel.say(f"looking for {rule} ...", progress=0)
        self.worker.submit("select", choose, done, viewer.fail)

    def stop(self) -> None:
        """Stop selecting by a rule."""
        self.worker.cancel("select")

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
        scene = edits.scene

        def write(stale: Stale) -> list[str]:
            return save_scene(scene, target)

        def done(said: list[str]) -> None:
            edits.mark_saved(scene)
            viewer.panel.say("\n".join(said))
            viewer.panel.refresh()
            then()

        viewer.panel.say(f"saving {target.name} ...")
        self.worker.submit("save scene", write, done, viewer.fail)

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
        dialogs.ask_among(self._viewer.modal, "Unsaved edits", text, choices)
        return True
