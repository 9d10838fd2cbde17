"""The panel beside the scenes: controls, legends and numbers."""

from __future__ import annotations

import textwrap
from itertools import zip_longest
from typing import Any

import numpy as np
from open3d.visualization import gui

from gs_codec.formats.coordinates import CONVENTION
from viewer.pictures.layers import Legend, heat_bar, reason_colour
from viewer.scenes.choice import CELL_COLOURINGS, COLOURINGS, DEPTHS, LAYERS, MODES
from viewer.scenes.numbers import between, facts
from viewer.scenes.pose import UPS
from viewer.window.pane import picture_of

_MODE_NAMES = ("side by side", "wipe", "one, F flips")

_DRAWN_BY = {"gpu": "splats: Open3D's shader", "cpu": "splats: our rasteriser, on the CPU"}


class Panel:
    """Checkboxes, choices and numbers of a viewer; they call its methods.

    Attributes
    ----------
    viewer : window.Viewer
    boxes : dict of str to gui.Checkbox
        By layer.
    """

    def __init__(self, viewer: Any, font: int) -> None:
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
            "centres by", COLOURINGS, lambda index: viewer.set_colouring(COLOURINGS[index])
        )
        self._add_octree()
        self.mode = self._choice(
            "two scenes", _MODE_NAMES, lambda index: viewer.set_mode(MODES[index])
        )
        self.up = self._choice("up axis", UPS, lambda index: viewer.set_up(viewer.views.ups[index]))
        self.turned = gui.Checkbox("reverse B's y and z axes (T)")
        self.turned.set_on_checked(lambda _: viewer.turn())
        self.widget.add_child(self.turned)
        self._views = gui.Horiz(0.3 * em)
        self._views.add_child(self._button("<", lambda: viewer.go(-1)))
        self._views.add_child(self._button(">", lambda: viewer.go(1)))
        self._views.add_child(self._button("Reset", viewer.reset))
        self.widget.add_child(self._views)
        self._view = gui.Label("")
        self.widget.add_child(self._view)
        self._legends = [_LegendRow(em) for _ in range(3)]
        bar = np.full((int(0.7 * em), 256, 4), 255, np.uint8)
        bar[..., :3] = np.rint(255 * heat_bar(bar.shape[1], bar.shape[0]))
        # Hidden instead of removed: see HIDDEN in pane.py.
        self._bars = [picture_of(bar * np.uint8(seen)) for seen in (False, True)]
        self._bar = gui.ImageWidget(self._bars[False])
        self._bar.ui_image.scaling = gui.UIImage.Scaling.ANY
        self.widget.add_child(self._bar)
        for row in self._legends:
            self.widget.add_child(row.widget)
        self._reasons = [gui.Label("") for _ in range(4)]
        for index, label in enumerate(self._reasons):
            label.text_color = gui.Color(*reason_colour(index))
            self.widget.add_child(label)
        self._numbers = gui.Label("")
        self._numbers.font_id = font
        self.widget.add_child(self._numbers)

    def _add_octree(self) -> None:
        """Controls of the octree, which show with it."""
        set_octree = self.viewer.set_octree
        self._octree = gui.Vert(0.25 * self._em)
        self.widget.add_child(self._octree)
        self.cells = self._choice(
            "octree by",
            CELL_COLOURINGS,
            lambda index: set_octree(colouring=CELL_COLOURINGS[index]),
            self._octree,
        )
        self.depth = gui.Slider(gui.Slider.INT)
        self.depth.set_limits(DEPTHS[0], DEPTHS[-1])
        self.depth.set_on_value_changed(lambda value: set_octree(depth=int(float(value))))
        self._octree.add_child(gui.Label("octree's depth"))
        self._octree.add_child(self.depth)

    def say(self, text: str, progress: float | None = None) -> None:
        """Show a status line; with `progress` (0-1), also a progress bar and a Stop button."""
        self.status.text = "\n".join(folded(text, 34))
        self._loading.visible = progress is not None
        self.show_progress(progress or 0.0)
        self.viewer.window.set_needs_layout()

    def show_progress(self, progress: float) -> None:
        """Set the progress bar, 0-1."""
        self.progress.value = progress
        self.viewer.window.post_redraw()

    def next_colouring(self) -> None:
        """Colour centres by the next of `COLOURINGS`."""
        index = (COLOURINGS.index(self.viewer.choice.colouring) + 1) % len(COLOURINGS)
        self.viewer.set_colouring(COLOURINGS[index])

    def next_up(self) -> None:
        """Select the next up axis."""
        names = self.viewer.views.ups
        self.viewer.set_up(names[(names.index(self.viewer.choice.up) + 1) % len(names)])

    def refresh(self) -> None:
        """Update all controls and numbers from the viewer."""
        viewer, choice, stage = self.viewer, self.viewer.choice, self.viewer.stage
        two = len(stage.scenes) > 1
        for layer, box in self.boxes.items():
            box.checked = layer in choice.layers
        self.boxes["pruned"].enabled = stage.pruned is not None
        self.boxes["error"].enabled = self.mode.enabled = two
        self.colouring.selected_index = COLOURINGS.index(choice.colouring)
        self._octree.visible = "octree" in choice.layers
        self.cells.selected_index = CELL_COLOURINGS.index(choice.octree.colouring)
        self.depth.int_value = choice.octree.depth
        self.mode.selected_index = MODES.index(choice.mode)
        self.turned.visible = two
        self.turned.checked = two and stage.scenes[1].system != CONVENTION
        if self.up.number_of_items != len(viewer.views.ups):
            self.up.clear_items()
            for name in viewer.views.ups:
                self.up.add_item(name)
        self.up.selected_index = viewer.views.ups.index(choice.up)
        self._views.visible = self._view.visible = bool(viewer.viewpoints)
        self._view.text = "\n".join(folded(viewer.where, 34))
        self._bar.update_image(self._bars[bool(stage.legends)])
        for row, legend in zip_longest(self._legends, stage.legends):
            row.show(legend)
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
            wide, high = stage.pose.measured if stage.pose is not None else (0, 0)
            lines += [
                "",
                f"B against A in the frame, {wide}x{high}:",
                f"  {stage.quality or '...'}",
            ]
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

    def _choice(
        self, text: str, names: Any, chosen: Any, parent: gui.Widget | None = None
    ) -> gui.Combobox:
        box = gui.Combobox()
        for name in names:
            box.add_item(name)
        box.set_on_selection_changed(lambda _, index: chosen(index))
        row = gui.Horiz(0.4 * self._em)
        row.add_child(gui.Label(text))
        row.add_child(box)
        (parent or self.widget).add_child(row)
        return box


class _LegendRow:
    """A legend below the colour bar: its values and title."""

    def __init__(self, em: float) -> None:
        self.widget = gui.Vert(0.1 * em)
        self._title = gui.Label("")
        self._marks = [gui.Label("") for _ in range(5)]
        row = gui.Horiz()
        for k, mark in enumerate(self._marks):
            if k:
                row.add_stretch()
            row.add_child(mark)
        self.widget.add_child(row)
        self.widget.add_child(self._title)

    def show(self, legend: Legend | None) -> None:
        """Show a legend, or none."""
        self.widget.visible = legend is not None
        if legend is not None:
            self._title.text = legend.title
            for label, mark in zip(self._marks, legend.marks, strict=True):
                label.text = mark


def monospace() -> int:
    """The font for numbers; call this before a window is created."""
    description = gui.FontDescription(gui.FontDescription.MONOSPACE)
    return gui.Application.instance.add_font(description)


def folded(text: str, width: int) -> list[str]:
    """The lines of a text, wrapped to at most `width` characters."""
    return [part for line in text.splitlines() for part in textwrap.wrap(line, width) or [""]]
