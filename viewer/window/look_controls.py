"""Controls for the appearance of splats."""

from __future__ import annotations

from dataclasses import replace

from open3d.visualization import gui

from viewer.scenes.choice import Appearance
from viewer.window.controls import Controls
from viewer.window.navigation import field_of_view
from viewer.window.widgets import Widgets

#: Range of the vertical field of view, degrees.
_ANGLES = (10, 120)

#: Range of the factor for the axes of splats.
_SCALES = (0.05, 2.0)


class LookControls:
    """Field of view, SH degree, scale and minimum opacity of splats, and background.

    Attributes
    ----------
    angle, degree, scale, opacity : gui.Slider
    background : gui.ColorEdit
    """

    def __init__(
        self, viewer: Controls, widgets: Widgets, upper: gui.Widget, below: gui.Widget
    ) -> None:
        self._viewer = viewer
        grid, put = widgets.grid(upper), viewer.set_appearance

        def look() -> Appearance:
            return viewer.choice.appearance

        self.angle = widgets.slider(grid, "field of view", _ANGLES, viewer.set_field_of_view)
        self.degree = widgets.slider(
            grid,
            "SH degree",
            (0, 3),
            lambda degree: put(replace(look(), sh_degree=int(degree))),
            whole=True,
        )
        self.scale = widgets.slider(
            grid, "splat scale", _SCALES, lambda x: put(replace(look(), scale=x))
        )
        self.opacity = widgets.slider(
            grid, "minimum opacity", (0.0, 1.0), lambda x: put(replace(look(), least_opacity=x))
        )
        self.background = gui.ColorEdit()
        self.background.set_on_value_changed(
            lambda c: put(replace(look(), background=(c.red, c.green, c.blue)))
        )
        grid.add_child(gui.Label("background"))
        grid.add_child(self.background)
        tip = "Show all SH degrees, scale 1, on black, as measurements do."
        self.plain = widgets.button("Defaults", lambda: put(Appearance()), tip)
        widgets.row(below, self.plain)

    def refresh(self) -> None:
        """Update the controls from the viewer."""
        stage, appearance = self._viewer.stage, self._viewer.choice.appearance
        if stage.pose is not None:
            self.angle.double_value = field_of_view(stage.pose)
        self.degree.int_value = appearance.sh_degree
        self.scale.double_value = appearance.scale
        self.opacity.double_value = appearance.least_opacity
        self.background.color_value = gui.Color(*appearance.background)
        self.plain.enabled = appearance != Appearance()
