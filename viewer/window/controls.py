"""The settings that the panel and the keys change."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.pictures.screenshot import compose, save_picture
from viewer.scenes.choice import COLOURINGS, MODES, SCALES, Appearance, OctreeChoice
from viewer.scenes.typed_paths import PICTURES
from viewer.scenes.worker import Stale
from viewer.window.annotating import Annotating
from viewer.window.background_encoding import Encoding
from viewer.window.dock import Dock
from viewer.window.editor import Editor
from viewer.window.loading import Loading
from viewer.window.measuring import Measuring
from viewer.window.navigation import field_of_view, framing, with_field_of_view
from viewer.window.picking import Picking
from viewer.window.placing import Placing
from viewer.window.player import Player
from viewer.window.shared import Host
from viewer.window.timeline import Timeline
from viewer.window.visits import Visits
from viewer.window.watching import Watching

#: Fields of view are equal within this tolerance, degrees.
_SAME_ANGLE = 0.01


class Controls(Host, Protocol):
    """A window, as seen by its panel and keys."""

    tabs: gui.TabControl
    visits: Visits
    timeline: Timeline
    measuring: Measuring
    annotating: Annotating
    watching: Watching
    loading: Loading
    picking: Picking
    editor: Editor
    placing: Placing
    player: Player
    encoding: Encoding
    dock: Dock

    def help(self) -> None:
        """Show the list of keys."""

    def play(self) -> None:
        """Play the sequence or, without one, fly along the camera path; stop if that goes on."""
        if self.player.moment is None:
            self.timeline.fly()
        else:
            self.player.toggle()

    def forget(self) -> None:
        """Forget lengths measured in the scene shown before."""
        self.measuring.take_unit()

    def follow(self, matrix: NDArray) -> None:
        """Move what was put on the first scene with it, by a matrix ``(4, 4)``."""
        self.annotating.follow(matrix)
        self.timeline.follow(matrix)
        self.measuring.follow(matrix)

    def measure(self) -> None:
        """Let clicks measure, or pick Gaussians again."""
        self.annotating.stop()
        self.measuring.toggle()

    def annotate(self) -> None:
        """Let clicks annotate, or pick Gaussians again."""
        if self.measuring.on:
            self.measuring.toggle()
        self.annotating.toggle()

    # Display settings

    def refresh(self) -> None:
        """Update panes, dock and panel to the choice."""
        self.stage.refresh()
        self.refresh_panel()

    def refresh_panel(self) -> None:
        """Update dock and panel; the panes are up to date."""
        self.dock.refresh()
        self.panel.refresh()

    def toggle(self, layer: str) -> None:
        """Switch a layer on or off."""
        self.choice.layers ^= {layer}
        self.refresh()

    def set_colouring(self, colouring: str) -> None:
        """Colour centres by another quantity."""
        self.choice.colouring = colouring
        self.refresh()

    def next_colouring(self) -> None:
        """Colour centres by the next of `COLOURINGS`."""
        index = (COLOURINGS.index(self.choice.colouring) + 1) % len(COLOURINGS)
        self.set_colouring(COLOURINGS[index])

    def set_logarithmic(self, logarithmic: bool) -> None:
        """Set whether the current colours of centres use a logarithmic scale."""
        self.choice.scales[self.choice.colouring] = SCALES[logarithmic]
        self.refresh()

    def set_octree(self, octree: OctreeChoice) -> None:
        """Change the depth or the colouring of the octree's cells."""
        self.choice.octree = octree
        self.stage.show_octree()

    def set_exact(self, exact: bool) -> None:
        """Set whether gs_codec's rasteriser draws splats even with a graphics card."""
        self.choice.exact = exact
        self.refresh()

    def set_appearance(self, appearance: Appearance) -> None:
        """Change how splats are drawn."""
        # Sliders also report values set by the program.
        if appearance != self.choice.appearance:
            self.choice.appearance = appearance
            self.stage.restyle()
            self.panel.refresh()

    def set_mode(self, mode: str) -> None:
        """Set how two scenes are shown."""
        self.choice.mode = mode
        self.refresh()

    def next_mode(self) -> None:
        """Show two scenes in the next of `MODES`."""
        self.set_mode(MODES[(MODES.index(self.choice.mode) + 1) % len(MODES)])

    def set_wipe(self, wipe: float) -> None:
        """Move the wipe line."""
        self.stage.wipe_to(wipe)

    def flip(self) -> None:
        """Show the other of two scenes, in flip mode."""
        choice = self.choice
        choice.mode, choice.front = "flip", 1 - choice.front if choice.mode == "flip" else 0
        self.refresh()

    def set_dock(self, dock: str) -> None:
        """Show another of `DOCKS` below the panes."""
        self.choice.dock = dock
        self.window.set_needs_layout()
        self.stage.arrange()
        self.refresh_panel()

    def next_dock(self) -> None:
        """Show the next of `DOCKS` below the panes."""
        self.set_dock(self.dock.next())

    # Camera

    def set_flying(self, flying: bool) -> None:
        """Set whether drags look around or orbit the point ahead."""
        self.choice.flying = flying
        self.panel.refresh()

    def set_field_of_view(self, degrees: float) -> None:
        """Set the vertical field of view of the frame."""
        pose = self.stage.pose
        # Sliders also report values set by the program.
        if pose is not None and abs(degrees - field_of_view(pose)) > _SAME_ANGLE:
            self.stage.steer(with_field_of_view(pose, degrees))

    def frame_all(self) -> None:
        """Move back or nearer until the whole scene is visible."""
        if self.stage.pose is not None:
            scene = self.stage.scenes[0]
            placed = scene.positions, scene.opacities, scene.lengths
            self.stage.look_from(*framing(self.stage.pose, *placed))

    # Files

    def ask_save(self) -> None:
        """Ask where to write a picture, and write it."""
        self.files.ask_save("Save a picture", PICTURES, self.save)

    def save(self, path: str) -> None:
        """Write a picture of the current view, drawn in software."""
        stage, mode, wipe = self.stage, self.choice.mode, self.choice.wipe
        if stage.pose is None:
            return
        pose, shown, size, front = stage.pose, stage.shown, stage.saved_size, self.choice.front

        def draw(stale: Stale) -> None:
            picture = compose(pose, shown, mode, wipe, size, front=front)
            save_picture(picture, Path(path))

        def done(_: None) -> None:
            self.panel.say(f"{Path(path).name} saved")

        self.worker.submit(f"save {path}", draw, done, self.fail)
