"""What an empty window offers: opening a scene, and the scenes opened last."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from open3d.visualization import gui

from viewer.scenes.recent import recent_files
from viewer.window.dialogs import shortened
from viewer.window.loading import Loading
from viewer.window.shared import Host

#: Number of recent files offered, and the maximum length of their names.
_RECENT, _LONGEST = 5, 28


class Start:
    """Buttons in the middle of the panes' space, while no scene is shown.

    Attributes
    ----------
    buttons : list of gui.Button
        The first opens the dialog for files, the others recent files.
    """

    def __init__(self, viewer: Host, loading: Loading) -> None:
        self._viewer = viewer
        recent = [str(path) for path in recent_files()[:_RECENT]]
        self.buttons = [
            gui.Button("Open a scene ..."),
            *(gui.Button(shortened(path, _LONGEST)) for path in recent),
        ]
        actions: list[Callable[[], None]] = [loading.ask_open]
        actions += [partial(loading.open, path) for path in recent]
        for button, action in zip(self.buttons, actions, strict=True):
            button.set_on_clicked(action)
            viewer.window.add_child(button)

    def lay_out(self, space: gui.Rect, context: gui.LayoutContext) -> None:
        """Place the buttons below the middle of the panes' space."""
        em, y = self._viewer.window.theme.font_size, space.y + space.height // 2 + 30
        for button in self.buttons:
            size = button.calc_preferred_size(context, gui.Widget.Constraints())
            fits = y + size.height <= space.get_bottom() and size.width <= space.width
            button.visible = fits and not self._viewer.stage.scenes and not self._viewer.panel.doing
            x = space.x + (space.width - size.width) // 2
            button.frame = gui.Rect(x, y, size.width, size.height)
            y += size.height + em // 2
