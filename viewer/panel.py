"""The panel beside the scenes: what is shown, and numbers."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from open3d.visualization import gui

from viewer.choice import MODES
from viewer.layers import COLOURINGS, LAYERS, heat_bar, reason_colour
from viewer.numbers import between, facts
from viewer.pane import picture_of

if TYPE_CHECKING:
    from viewer.window import Viewer

_MODE_NAMES = ("side by side", "wipe", "one, F flips")

_DRAWN_BY = {"gpu": "splats: Open3D's shader", "cpu": "splats: our rasteriser, on the CPU"}


class Panel:
    """Checkboxes, choices and numbers of a viewer.

    Attributes
    ----------
    boxes : dict of str to gui.Checkbox
        By layer.
    """

    def __init__(self, viewer: Viewer, font: int) -> None:
        self.viewer = viewer
        em = viewer.window.theme.font_size
        self._em = em
        margins = gui.Margins(0.6 * em, 0.5 * em, 0.6 * em, 0.5 * em)
        self.widget = gui.ScrollableVert(0.25 * em, margins)
        self.boxes = {layer: self._checkbox(layer) for layer in LAYERS}
        buttons = gui.Horiz(0.3 * em)
        for text, action in (
            ("Open", viewer.ask_open),
            ("Save", viewer.ask_save),
            ("Help", viewer.help),
        ):
            buttons.add_child(self._button(text, action))
        self.widget.add_child(buttons)
        self.status = gui.Label("")
        self.widget.add_child(self.status)
        self.progress = gui.ProgressBar()
        self.stop = self._button("Stop", viewer.stop_loading)
        self._loading = gui.Vert(0.3 * em)
        self._loading.add_child(self.progress)
        self._loading.add_child(self.stop)
        self._loading.visible = False
        self.widget.add_child(self._loading)
        for box in self.boxes.values():
            self.widget.add_child(box)
        self.colouring = self._choice(
            "centres by", COLOURINGS, lambda place: viewer.set_colouring(COLOURINGS[place])
        )
        self.mode = self._choice(
            "two scenes", _MODE_NAMES, lambda place: viewer.set_mode(MODES[place])
        )
        self.wipe = gui.Slider(gui.Slider.DOUBLE)
        self.wipe.set_limits(0, 1)
        self.wipe.set_on_value_changed(lambda place: viewer.set_place(float(place)))
        self.widget.add_child(self.wipe)
        self._cameras = gui.Horiz(0.3 * em)
        self._cameras.add_child(self._button("<", lambda: viewer.go(-1)))
        self._cameras.add_child(self._button(">", lambda: viewer.go(1)))
        self._camera = gui.Label("")
        self._cameras.add_child(self._camera)
        self.widget.add_child(self._cameras)
        bar = np.full((int(0.7 * em), int(14 * em), 4), 255, np.uint8)
        bar[..., :3] = np.rint(255 * heat_bar(bar.shape[1], bar.shape[0]))
        # Unseen rather than taken away: see HIDDEN in pane.py.
        self._bars = [picture_of(bar * np.uint8(seen)) for seen in (False, True)]
        self._bar = gui.ImageWidget(self._bars[False])
        self.widget.add_child(self._bar)
        self._legend = gui.Label("")
        self.widget.add_child(self._legend)
        self._reasons = [gui.Label("") for _ in range(4)]
        for place, label in enumerate(self._reasons):
            label.text_color = gui.Color(*reason_colour(place))
            self.widget.add_child(label)
        self._numbers = gui.Label("")
        self._numbers.font_id = font
        self.widget.add_child(self._numbers)

    def say(self, text: str, progress: float | None = None) -> None:
        """Show a line of status; of what can be stopped, how far it is, 0-1."""
        self.status.text = "\n".join(folded(text, 34))
        self._loading.visible = progress is not None
        self.show_progress(progress or 0.0)
        self.viewer.window.set_needs_layout()

    def show_progress(self, progress: float) -> None:
        """Show how far it is, 0-1."""
        self.progress.value = progress
        self.viewer.window.post_redraw()

    def next_colouring(self) -> None:
        """Colour centres by the next of what is known."""
        place = (COLOURINGS.index(self.viewer.choice.colouring) + 1) % len(COLOURINGS)
        self.viewer.set_colouring(COLOURINGS[place])

    def refresh(self) -> None:
        """Show what the viewer shows."""
        viewer, choice, stage = self.viewer, self.viewer.choice, self.viewer.stage
        two = len(stage.scenes) > 1
        for layer, box in self.boxes.items():
            box.checked = layer in choice.layers
        self.boxes["pruned"].enabled = stage.pruned is not None
        self.boxes["error"].enabled = self.mode.enabled = two
        self.colouring.selected_index = COLOURINGS.index(choice.colouring)
        self.mode.selected_index = MODES.index(choice.mode)
        self.wipe.visible = two and choice.mode == "wipe"
        self.wipe.double_value = choice.place
        self._cameras.visible = bool(viewer.cameras)
        if viewer.cameras:
            name = viewer.cameras[viewer.number].name
            self._camera.text = f"{viewer.number} of {len(viewer.cameras)}: {name}"
        legends = [*stage.legends, *([stage.error_legend] if stage.error_legend else [])]
        self._bar.update_image(self._bars[bool(legends)])
        self._legend.visible = bool(legends)
        self._legend.text = "\n".join(f"{e.title}: {e.low} to {e.high}" for e in legends)
        counts = list(stage.pruned.counts.items()) if stage.pruned is not None else []
        for label, (reason, n) in zip(self._reasons, counts + [("", 0)] * 4, strict=False):
            label.visible = bool(n)
            label.text = f"{n:,} pruned by {reason}"
        self._numbers.text = self._all_numbers()
        viewer.window.set_needs_layout()

    def _all_numbers(self) -> str:
        stage = self.viewer.stage
        lines = [_DRAWN_BY[stage.device]] if stage.scenes else []
        if len(stage.scenes) > 1:
            lines += ["", "this view, B against A:", f"  {stage.quality or '...'}"]
            lines += [f"{name}: {value}" for name, value in between(*stage.scenes)]
        for letter, scene in zip("AB", stage.scenes, strict=False):
            lines += ["", f"{letter}: {scene.name}"]
            lines += [f"{name:<16} {value:>12}" for name, value in facts(scene)]
        return "\n".join(lines)

    def _checkbox(self, layer: str) -> gui.Checkbox:
        box = gui.Checkbox(layer)
        box.set_on_checked(lambda _: self.viewer.toggle(layer))
        return box

    def _button(self, text: str, action: Any) -> gui.Button:
        button = gui.Button(text)
        button.horizontal_padding_em, button.vertical_padding_em = 0.5, 0.1
        button.set_on_clicked(action)
        return button

    def _choice(self, text: str, names: Any, chosen: Any) -> gui.Combobox:
        box = gui.Combobox()
        for name in names:
            box.add_item(name)
        box.set_on_selection_changed(lambda _, place: chosen(place))
        row = gui.Horiz(0.4 * self._em)
        row.add_child(gui.Label(text))
        row.add_child(box)
        self.widget.add_child(row)
        return box


def monospace() -> int:
    """The font of numbers; to be asked for before there is a window."""
    description = gui.FontDescription(gui.FontDescription.MONOSPACE)
    return gui.Application.instance.add_font(description)


def folded(text: str, width: int) -> list[str]:
    """Its lines, none longer than so many characters."""
    return [part for line in text.splitlines() for part in textwrap.wrap(line, width) or [""]]
