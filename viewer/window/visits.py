"""Viewpoints of a window, and the photograph of the one visited last."""

from __future__ import annotations

import numpy as np
from open3d.visualization import gui

import gs_codec
from gs_codec.cameras.image_files import find_image
from gs_codec.cameras.up import BY_CAMERAS
from gs_codec.cli.main import describe_error
from gs_codec.runtime.wording import counted
from gs_codec.views.photographs import read_photograph
from viewer.scenes.viewpoints import Viewpoint, Views, choose_views, find_viewpoints
from viewer.scenes.worker import Stale
from viewer.window.backdrop import picture_of
from viewer.window.pane import HIDDEN
from viewer.window.shared import Host

#: Text for the panel if the up axis is uncertain.
_UNSURE = "The up axis is uncertain: press U to choose another."


class Visits:
    """The viewpoints of a window, and the current one.

    Parameters
    ----------
    viewer : Host

    Attributes
    ----------
    views : Views
    viewpoints : list of Viewpoint
        The overview and the cameras.
    number : int
        Index of the viewpoint visited last.
    photographed : bool
        Whether a photograph is shown next to the scenes.
    photograph : gui.ImageWidget
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self.views = Views()
        self.viewpoints: list[Viewpoint] = []
        self.number = 0
        self._more_views = self._was_moved = False
        self._behind = viewer.choice.appearance.background  # transparent parts of the photograph
        self.photograph = gui.ImageWidget()
        self.photograph.visible = self.photographed = False
        self._caption = gui.Label("")
        viewer.window.add_child(self.photograph)
        viewer.window.add_child(self._caption)

    def put(self, views: Views, first: int) -> None:
        """Use other views of the first scene, starting with viewpoint `first`."""
        viewer = self._viewer
        viewer.worker.cancel("cameras")
        self.views = views
        viewer.choice.up = viewer.request.up or views.ups[0]
        self._find()
        self.go_to(first)
        # Choosing views takes seconds; if the rasteriser draws, it happens after the first full
        # picture.
        self._more_views = views.chosen and len(views.cameras) == 1
        if not views.up_certain:
            self._say_up()
        if not viewer.stage.by_hand:
            self.choose_more()

    def choose_more(self) -> None:
        """Choose further views of the scene after the overview, which is kept."""
        if not self._more_views:
            return
        self._more_views = False
        viewer = self._viewer
        scene, up = viewer.stage.scenes[0], viewer.request.up

        def choose(stale: Stale) -> Views:
            return choose_views(scene, up)

        def done(views: Views) -> None:
            here = self.viewpoints[0]
            self.views = views
            self._say_up()
            self._find()
            self.viewpoints[0] = here
            viewer.refresh_panel()

        viewer.panel.say("choosing views ...")
        viewer.worker.submit(
            "cameras", choose, done, lambda error: viewer.panel.say(describe_error(error))
        )

    def _find(self) -> None:
        viewer = self._viewer
        up = viewer.choice.up
        self.viewpoints = find_viewpoints(viewer.stage.scenes[0], self.views, up)
        viewer.stage.navigator.up = self.views.up_axis(up)

    def _say_up(self) -> None:
        """Show a message if the up axis is uncertain."""
        unsure = not self.views.up_certain and self._viewer.choice.up == BY_CAMERAS
        self._viewer.panel.say(_UNSURE if unsure else "")

    def set_up(self, up: str) -> None:
        """Set the up axis, for the overview and for cameras chosen from the scene."""
        self._viewer.choice.up = up
        if not self.views.up_certain:
            self._say_up()
        if self.viewpoints:
            self._find()
            self.go_to(self.number if self._viewer.request.chosen else 0)

    def next_up(self) -> None:
        """Select the next up axis."""
        names = self.views.ups
        self.set_up(names[(names.index(self._viewer.choice.up) + 1) % len(names)])

    def go(self, step: int) -> None:
        """Go `step` viewpoints forward or back."""
        if self.viewpoints:
            self.go_to((self.number + step) % len(self.viewpoints))

    def reset(self) -> None:
        """Go back to the viewpoint visited last."""
        if self.viewpoints:
            self.go_to(self.number)

    def overview(self) -> None:
        """Go to the overview."""
        if self.viewpoints:
            self.go_to(0)

    def go_to(self, number: int) -> None:
        """Go to a viewpoint by its index."""
        self.number = number
        self.show_photograph()
        self._viewer.stage.look_from(self.viewpoints[number].pose)
        self._viewer.refresh_panel()

    @property
    def moved(self) -> bool:
        """Whether the pose has moved away from the viewpoint visited last."""
        pose = self._viewer.stage.pose
        return bool(self.viewpoints) and pose is not self.viewpoints[self.number].pose

    @property
    def where(self) -> str:
        """Text that describes the current viewpoint."""
        count = len(self.viewpoints) - 1
        text = f"overview; {counted(count, 'view')}"
        if self.number:
            index, count = self.number - self.views.first, len(self.views.cameras)
            name = self.viewpoints[self.number].name
            text = f"{name}, {index + 1} of {count} (--view {index})"
        return f"moved away from {text} (R returns)" if self.moved else text

    def tick(self) -> None:
        """Follow moves from and to viewpoints, and changes of the background."""
        if self.moved != self._was_moved:
            self._was_moved = self.moved
            self._viewer.refresh_panel()
        is_behind = self._behind == self._viewer.choice.appearance.background
        if self.photographed and not is_behind and self._viewer.stage.resting:
            self.show_photograph()

    def show_photograph(self) -> None:
        """Show the photograph of the viewpoint visited last, if it has one."""
        viewer = self._viewer
        self.photographed, self._behind = False, viewer.choice.appearance.background
        camera = self.viewpoints[self.number].camera
        if viewer.request.images is not None and self.number and camera is not None:
            try:
                path = find_image(viewer.request.images, camera.name)
                _, image = read_photograph(camera, path, self._behind)
            except gs_codec.GsCodecError as error:
                viewer.panel.say(str(error))
            else:
                pixels = np.rint(255 * image).astype(np.uint8)
                self.photograph.update_image(picture_of(pixels))
                self.photograph.visible = self.photographed = True
                viewer.panel.say("")
        viewer.window.set_needs_layout()

    def lay_out(self, rect: gui.Rect, panes: int, line: int, hidden: gui.Rect) -> int:
        """Place the photograph next to `panes` panes; return the width left for the panes.

        `line` is the height of its caption, pixels; a hidden photograph is put at the corner of
        `hidden`, behind the panel, because Open3D makes it larger than `HIDDEN`.
        """
        self.photograph.frame = gui.Rect(hidden.x, hidden.y, *HIDDEN)
        self._caption.visible = self.photographed
        if not self.photographed:
            return rect.width
        wide = rect.width // (panes + 1)
        left = rect.get_right() - wide
        self.photograph.frame = gui.Rect(left, rect.y + line, wide, rect.height - line)
        self._caption.frame = gui.Rect(left, rect.y, wide, line)
        moved = " (you have moved away)" if self.moved else ""
        self._caption.text = f" photograph of {self.viewpoints[self.number].name}{moved}"
        return rect.width - wide
