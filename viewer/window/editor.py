"""Selecting and editing the scenes of a window: tools, steps, saving."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import gs_codec
from viewer.scenes.edits import Edits
from viewer.scenes.opened import Opened
from viewer.scenes.region import REGIONS, Pixel, Region, in_region
from viewer.scenes.saving import save_scene
from viewer.scenes.selecting import by_rule, in_range, inside_box, rules
from viewer.window import dialogs
from viewer.window.worker import Stale, Worker

if TYPE_CHECKING:
    from viewer.window.viewer import Viewer

#: What a drag in a pane does: the first moves the camera, the others draw a region.
TOOLS = ("navigate", *REGIONS)


class Editor:
    """The edits of the scenes of a window, and the tool that draws regions.

    Parameters
    ----------
    viewer : Viewer

    Attributes
    ----------
    tool : str
        One of `TOOLS`.
    number : int
        Which scene is edited: 0 or 1.
    worker : Worker
        What selects and saves; pictures are drawn meanwhile.
    """

    def __init__(self, viewer: Viewer) -> None:
        self.viewer = viewer
        self.tool = "navigate"
        self.number = 0
        self._edits: list[Edits] = []
        self._region: Region | None = None
        self._how = "replace"
        self.worker = Worker(viewer.post)

    def put(self, scenes: Sequence[Opened]) -> None:
        """Take on the scenes that are shown; those that were there keep their edits."""
        known = {edits.scene: edits for edits in self._edits}
        self._edits = [known.get(scene) or Edits(scene) for scene in scenes]
        self.number = min(self.number, max(len(scenes) - 1, 0))
        self._region = None

    @property
    def edits(self) -> Edits | None:
        """The edits of the scene that is edited; None without one."""
        return self._edits[self.number] if self._edits else None

    @property
    def unsaved(self) -> list[int]:
        """Which scenes have edits that are not saved."""
        return [k for k, edits in enumerate(self._edits) if edits.unsaved]

    @property
    def rules(self) -> list[str]:
        """The rules by which Gaussians of the scene can be selected."""
        return rules(self.viewer.stage.pruned if self.number == 0 else None)

    # The tool

    def set_tool(self, tool: str) -> None:
        """Choose a tool of `TOOLS`; a second time, go back to the first."""
        self.tool = TOOLS[0] if tool == self.tool else tool
        self.viewer.panel.refresh()

    def press(self, number: int, place: Pixel, how: str) -> None:
        """Begin to draw a region in a pane, at a pixel of its scene's picture."""
        self.number, self._how = number, how
        self._region = Region(self.tool, place)

    def drag(self, place: Pixel) -> None:
        """Draw on."""
        if self._region is not None:
            self._region.extend(place)
            self.viewer.stage.show_stroke(self.number, self._region.corners)

    def release(self) -> None:
        """Select what is in the region; a click selects nothing, and drops the selection."""
        region, self._region = self._region, None
        stage, edits = self.viewer.stage, self.edits
        if region is None or edits is None or stage.pose is None:
            return
        stage.show_stroke(self.number, [])
        scene, size = edits.scene, stage.picture_size
        chosen = in_region(scene, stage.pose, size, region.corners, edits.drawn)
        self.do(lambda edits: edits.select(chosen, self._how))

    # Steps

    def do(self, step: Callable[[Edits], None]) -> None:
        """Do a step with the scene that is edited, and show what came of it."""
        edits = self.edits
        if edits is None:
            return
        try:
            step(edits)
        except gs_codec.GsCodecError as error:
            self.viewer.fail(error)
            return
        self.show()

    def show(self) -> None:
        """Show the edits in the panes and in the panel."""
        stage = self.viewer.stage
        for number, edits in enumerate(self._edits):
            if stage.scenes[number] is not edits.scene:
                stage.replace(number, edits.scene)
            stage.mark(number, edits.selected if edits.count else None)
        self.viewer.panel.refresh()

    def drawn(self, scene: Opened) -> NDArray[np.bool_] | None:
        """Which Gaussians ``(N,)`` of a scene are drawn; None if none is hidden."""
        found = [edits.drawn for edits in self._edits if edits.scene is scene]
        return found[0] if found else None

    def select_range(
        self, scene: Opened, quantity: str, low: float, high: float, how: str = "replace"
    ) -> None:
        """Select by a range of a quantity, both ends included; see `in_range`."""
        shown = [edits.scene for edits in self._edits]
        if scene in shown:
            self.number = shown.index(scene)
            self.do(lambda edits: edits.select(in_range(scene, quantity, low, high), how))

    def crop(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Delete what is outside a box."""
        self.do(lambda edits: edits.keep(inside_box(edits.scene, low, high), "crop"))

    @property
    def box(self) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Lowest and highest coordinates ``(3,)`` of what is selected; None if nothing is."""
        edits = self.edits
        if edits is None or not edits.count:
            return None
        centres = edits.scene.positions[edits.selected]
        return centres.min(axis=0), centres.max(axis=0)

    def select_by(self, rule: str) -> None:
        """Select by a rule of `rules`, in the background."""
        edits, viewer = self.edits, self.viewer
        if edits is None:
            return
        scene, pruned, views = edits.scene, viewer.stage.pruned, viewer.views
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

    # Saving

    def ask_save(self, then: Callable[[], None] = lambda: None) -> None:
        """Ask where to save the scene that is edited, and save it; then do something."""
        dialogs.ask_save_scene(self.viewer.modal, lambda path: self.save(path, then))

    def save(self, path: str, then: Callable[[], None] = lambda: None) -> None:
        """Save the scene that is edited, in the background; the suffix selects the format."""
        edits, viewer, target = self.edits, self.viewer, Path(path)
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
        """Ask what to do with unsaved edits of these scenes, if there are any, before `then`.

        Returns
        -------
        bool
            Whether it asks; if not, `then` is not called.
        """
        asked = [k for k in numbers if k in self.unsaved]
        if not asked:
            return False
        self.number = asked[0]
        edits = self._edits[asked[0]]

        def discard() -> None:
            edits.mark_saved(edits.scene)
            if not self.ask_unsaved(numbers, then):
                then()

        def save() -> None:
            self.ask_save(discard)

        text = f"{edits.scene.name} was edited and is not saved."
        choices = {"Save as ...": save, "Discard": discard, "Cancel": lambda: None}
        dialogs.ask_among(self.viewer.modal, "Unsaved edits", text, choices)
        return True
