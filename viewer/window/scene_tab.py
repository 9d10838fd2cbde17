"""The scene tab: files, layers, colours, numbers."""

from __future__ import annotations

from dataclasses import replace

from open3d.visualization import gui

from gs_codec.formats.coordinates import CONVENTION
from viewer.pictures.layers import reason_colour
from viewer.scenes.choice import CELL_COLOURINGS, COLOURINGS, DEPTHS, LAYERS, MODES, SCALED
from viewer.scenes.numbers import between, facts
from viewer.window.controls import Controls
from viewer.window.widgets import Widgets

_MODE_NAMES = ("side by side", "wipe", "one (F switches)")

_DRAWN_BY = {True: "splats: Open3D's shader", False: "splats: our rasteriser, on the CPU"}


class SceneTab:
    """Files, layers and numbers of the scenes.

    Attributes
    ----------
    widget : gui.Widget
    boxes : dict of str to gui.Checkbox
        Checkboxes by layer.
    colouring, cells, mode : gui.Combobox
    logarithmic : gui.Checkbox
        Whether the colour scale is logarithmic.
    depth : gui.Slider
    exact : gui.Checkbox
        Shown only if a graphics card draws.
    """

    def __init__(self, viewer: Controls, widgets: Widgets, font: int) -> None:
        self._viewer = viewer
        self.widget, self._upper, below = widgets.tab()
        self._add_files(widgets)
        self.boxes = {
            layer: widgets.checkbox(layer, lambda _, layer=layer: viewer.toggle(layer))  # type: ignore[misc]
            for layer in LAYERS
        }
        rows = list(self.boxes.values())
        for k in range(0, len(rows), 3):
            widgets.row(self._upper, *rows[k : k + 3])
        self.logarithmic = widgets.checkbox("log", viewer.set_logarithmic)
        self.logarithmic.tooltip = "Use a logarithmic colour scale."
        self.colouring = widgets.choice(
            self._upper,
            "centres by",
            COLOURINGS,
            lambda k: viewer.set_colouring(COLOURINGS[k]),
            self.logarithmic,
        )
        self._add_octree(widgets)
        self.mode = widgets.choice(
            below, "two scenes", _MODE_NAMES, lambda k: viewer.set_mode(MODES[k])
        )
        self.exact = widgets.checkbox("exact splats (CPU)", viewer.set_exact)
        self.exact.tooltip = "All SH degrees, as in measurements; slower than the graphics card."
        self.exact.visible = viewer.stage.has_shader
        below.add_child(self.exact)
        self.turned = widgets.checkbox(
            "reverse B's y and z axes (T)", lambda _: viewer.loading.turn()
        )
        below.add_child(self.turned)
        self._reasons = [gui.Label("") for _ in range(4)]
        for index, label in enumerate(self._reasons):
            label.text_color = gui.Color(*reason_colour(index))
            below.add_child(label)
        self.numbers = gui.Label("")
        self.numbers.font_id = font
        below.add_child(self.numbers)

    def _add_files(self, widgets: Widgets) -> None:
        """Buttons that open and save files."""
        loading = self._viewer.loading
        rows = (
            (
                ("Open A", lambda: loading.ask_open(0)),
                ("Open B", lambda: loading.ask_open(1)),
                ("Recent", loading.ask_recent),
                ("Help", self._viewer.help),
            ),
            (
                ("Cameras", loading.ask_cameras),
                ("Photos", loading.ask_photographs),
                ("Report", loading.ask_report),
                ("Picture", self._viewer.ask_save),
            ),
        )
        tips = {
            "Photos": "Show the cameras' photographs, from a folder.",
            "Report": "Show the Gaussians pruned from A (report.json of prepare).",
            "Picture": "Save a picture of the view.",
        }
        for row in rows:
            buttons = [widgets.button(text, action, tips.get(text, "")) for text, action in row]
            widgets.row(self._upper, *buttons)
        self.watch = widgets.checkbox("reload files that change", self._viewer.watching.set_on)
        self._upper.add_child(self.watch)

    def _add_octree(self, widgets: Widgets) -> None:
        """Controls of the octree, visible while its layer is on."""
        viewer = self._viewer
        self._octree = gui.Vert(0.25 * widgets.em)
        self._upper.add_child(self._octree)
        self.cells = widgets.choice(
            self._octree,
            "octree by",
            CELL_COLOURINGS,
            lambda k: viewer.set_octree(
                replace(viewer.choice.octree, colouring=CELL_COLOURINGS[k])
            ),
        )
        ends = DEPTHS[0], DEPTHS[-1]
        self.depth = widgets.slider(
            self._octree,
            "octree depth",
            ends,
            lambda value: viewer.set_octree(replace(viewer.choice.octree, depth=int(value))),
            whole=True,
        )

    def refresh(self) -> None:
        """Update controls and numbers."""
        choice, stage = self._viewer.choice, self._viewer.stage
        two = len(stage.scenes) > 1
        self.watch.checked = self._viewer.watching.on
        for layer, box in self.boxes.items():
            box.checked = layer in choice.layers
        self.boxes["pruned"].enabled = stage.pruned is not None
        self.boxes["error"].enabled = self.mode.enabled = two
        self.colouring.selected_index = COLOURINGS.index(choice.colouring)
        self.logarithmic.enabled = choice.colouring in SCALED
        self.logarithmic.checked = choice.scale == "log"
        self._octree.visible = "octree" in choice.layers
        self.cells.selected_index = CELL_COLOURINGS.index(choice.octree.colouring)
        self.depth.int_value = choice.octree.depth
        self.mode.selected_index = MODES.index(choice.mode)
        self.exact.checked = choice.exact
        self.turned.visible = two
        self.turned.checked = two and stage.scenes[1].system != CONVENTION
        pruned = None if stage.pruned is None else stage.pruned.of(stage.scenes[0])
        counts = [] if pruned is None else list(pruned.counts.items())
        for label, (reason, n) in zip(self._reasons, counts + [("", 0)] * 4, strict=False):
            label.visible = bool(n)
            label.text = f"{n:,} pruned by {reason}"
        self.numbers.text = self._all_numbers()

    def _all_numbers(self) -> str:
        stage = self._viewer.stage
        lines = [_DRAWN_BY[stage.by_shader]] if stage.scenes else []
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
