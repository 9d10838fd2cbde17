"""The rate tab: encoding settings, trial encodings and their results."""

from __future__ import annotations

import math
from typing import SupportsFloat

from open3d.visualization import gui

from gs_codec.config import PROFILE_CHOICES
from gs_codec.rate.search import COARSEST, FINEST
from gs_codec.runtime.wording import size_text
from viewer.scenes.numbers import quality_text
from viewer.scenes.opened import Opened
from viewer.scenes.trial_list import (
    WISHES,
    EncodingSettings,
    Scale,
    Trial,
    has_steps,
    scales_of,
)
from viewer.scenes.typed_paths import TRIALS
from viewer.window.controls import Controls
from viewer.window.dialogs import folded, shortened
from viewer.window.widgets import Widgets

#: Labels of the targets.
_WISHES = ("steps, times the profile's", "size, MB", "bits / Gaussian", "loss of views, dB")

#: Relative tolerance for equal values, because widgets round to float32.
_SAME = 1e-5

#: Width of a line, characters.
_COLUMNS = 38

#: Number of lines in the list.
_LINES = 9


class RateTab:
    """Encoding settings, and the list of trials.

    Attributes
    ----------
    widget : gui.Widget
    profile, wish : gui.Combobox
    guided : gui.Checkbox
    number : gui.NumberEdit
    slider : gui.Slider
    start, stop, as_a, as_b, save : gui.Button
    list : gui.ListView
    lines : list of str
        Lines of the list: the source, then the trials, newest first.
    """

    def __init__(self, viewer: Controls, widgets: Widgets, font: int) -> None:
        self._viewer = viewer
        self.widget, self._upper, self._below = widgets.tab()
        self._scales: dict[str, Scale] = {}
        self._source: Opened | None = None
        self.lines: list[str] = []
        self._places: list[int] = []
        self._chosen = 0
        self._add_request(widgets)
        self._add_trials(widgets)
        self._numbers = gui.Label("")
        self._numbers.font_id = font
        self._below.add_child(self._numbers)

    def _add_request(self, widgets: Widgets) -> None:
        """Controls for encoding settings."""
        self.profile = widgets.choice(
            self._upper, "profile", PROFILE_CHOICES, lambda _: self.refresh()
        )
        self.profile.selected_text = "m"
        self.guided = widgets.checkbox("camera-guided", lambda _: self.refresh())
        self.guided.tooltip = "use the open cameras, otherwise estimated ones"
        self._upper.add_child(self.guided)
        self.wish = widgets.choice(self._upper, "by", _WISHES, lambda _: self.refresh())
        self.number = gui.NumberEdit(gui.NumberEdit.DOUBLE)
        self.number.decimal_precision = 3
        self.number.set_limits(1e-3, 1e6)
        self.number.set_on_value_changed(self.set_value)
        self._upper.add_child(self.number)
        self.slider = gui.Slider(gui.Slider.DOUBLE)
        self.slider.set_on_value_changed(self._slide)
        self._upper.add_child(self.slider)
        self.start = widgets.button("Encode", lambda: self._viewer.encoding.encode(self.settings))
        self.stop = widgets.button("Cancel", self._viewer.encoding.cancel)
        widgets.row(self._below, self.start, self.stop)
        self._doing = gui.Label("")
        self.progress = gui.ProgressBar()
        self._below.add_child(self._doing)
        self._below.add_child(self.progress)

    def _add_trials(self, widgets: Widgets) -> None:
        """The list of trials."""
        self.list = gui.ListView()
        self.list.set_max_visible_items(_LINES)
        self.list.set_on_selection_changed(self._select)
        self._below.add_child(self.list)
        self.as_a = widgets.button("Show as A", lambda: self._show(0))
        self.as_b = widgets.button("Show as B", lambda: self._show(1))
        self.save = widgets.button("Save", self._ask_save)
        widgets.row(self._below, self.as_a, self.as_b, self.save)

    @property
    def numbers_text(self) -> str:
        """Numbers of the selected trial."""
        return str(self._numbers.text)

    @property
    def settings(self) -> EncodingSettings:
        """Settings chosen by the controls."""
        profile, wish = self.profile.selected_text, WISHES[self.wish.selected_index]
        if not has_steps(profile):
            return EncodingSettings(profile)
        value = self._scales[wish].value * (1e6 if wish == "size" else 1)
        return EncodingSettings(profile, wish, value, self.guided.checked or wish == "loss")

    def set_value(self, value: SupportsFloat) -> None:
        """Set the target's value; step sizes to the nearest that can be encoded."""
        wish, number = WISHES[self.wish.selected_index], float(value)
        if wish == "steps":
            number = min(max(number, 2.0**FINEST), 2.0**COARSEST)
        scale, is_possible = self._scales.get(wish), number == float(value)
        if scale is None or (is_possible and math.isclose(number, scale.value, rel_tol=_SAME)):
            return
        scale.value = number
        self.refresh()

    def _slide(self, value: SupportsFloat) -> None:
        """Set the target's value from the slider, which also reports values set by the program."""
        scale = self._scales.get(WISHES[self.wish.selected_index])
        if scale is not None and not math.isclose(float(value), scale.within, rel_tol=_SAME):
            self.set_value(value)

    def _show(self, pane: int) -> None:
        self._viewer.encoding.show(self._chosen, pane)

    def _ask_save(self) -> None:
        encoding, number = self._viewer.encoding, self._chosen
        source = encoding.scenes[0].path
        self._viewer.files.ask_save(
            "Save the encoding", TRIALS, lambda path: encoding.save(number, path), scene=source
        )

    def _select(self, _: str, twice: bool) -> None:
        """Select an entry of the list; on a double click, show it as B."""
        place = self.list.selected_index
        if 0 <= place < len(self._places):
            self._chosen = self._places[place]
            self.refresh()
            if twice:
                self._show(1)

    def refresh(self) -> None:
        """Update controls, list and numbers."""
        self._refresh_request()
        encoding = self._viewer.encoding
        self.start.enabled = bool(self._viewer.stage.scenes) and not encoding.encodes
        self.stop.enabled = encoding.doing is not None
        self._doing.text, self.progress.value = encoding.doing or ("", 0.0)
        self._refresh_trials()
        self._viewer.window.post_redraw()

    def _refresh_request(self) -> None:
        """Update the controls to the scene, and to each other."""
        scenes = self._viewer.stage.scenes
        if not scenes:
            return
        if self._source is not scenes[0]:
            self._source = scenes[0]
            self._find_scales(scenes[0])
        steps, wish = has_steps(self.profile.selected_text), WISHES[self.wish.selected_index]
        scale = self._scales[wish]
        for control in (self.wish, self.number, self.slider):
            control.enabled = steps
        self.guided.enabled = steps and wish != "loss"
        if self.number.double_value != scale.value:
            self.number.double_value = scale.value
        self.slider.set_limits(scale.low, scale.high)
        self.slider.double_value = scale.within

    def _find_scales(self, scene: Opened) -> None:
        """Set slider ranges for a scene; chosen values are kept."""
        found = scales_of(scene)
        for name, before in self._scales.items():
            found[name].value = before.value
        self._scales = found

    def _refresh_trials(self) -> None:
        """Update the list (the source, then the newest trial first) and the numbers."""
        encoding = self._viewer.encoding
        entries = list(encoding.scenes)
        if len(entries) != len(self._places):
            self._places = [*range(len(entries))[:1], *range(len(entries) - 1, 0, -1)]
            self._chosen = max(len(entries) - 1, 0)
        lines = [f"{encoding.letters(k) or '   '}  {_line(entries[k])}" for k in self._places]
        if lines != self.lines:
            self.lines = lines
            self.list.set_items(lines)
        if entries:
            self.list.selected_index = self._places.index(self._chosen)
        for button in (self.as_a, self.as_b):
            button.enabled = bool(entries)
        chosen = entries[self._chosen] if entries else None
        self.save.enabled = isinstance(chosen, Trial)
        self._numbers.text = self._numbers_of(chosen) if isinstance(chosen, Trial) else ""

    def _numbers_of(self, tried: Trial) -> str:
        """Numbers of a trial."""
        report, quality, stage = tried.report, tried.quality, self._viewer.stage
        rows = [
            ("file", size_text(report.file_bytes)),
            ("source / file", f"{report.ratio:.1f}"),
            ("bits / Gaussian", f"{tried.bits:.1f}"),
        ]
        if has_steps(tried.settings.profile):
            rows.append(("steps, x profile's", f"{report.coarseness:.3g}"))
        if report.dropped:
            rows.append(("not finite, dropped", f"{report.dropped:,}"))
        lines = folded(tried.name, _COLUMNS) + [f"{name:<20}{value:>14}" for name, value in rows]
        if "B" in self._viewer.encoding.letters(tried.number):
            lines += ["", "B against A, this view:", f"  {stage.quality or '...'}"]
        if quality is not None:
            lines += ["", f"{len(quality.views)} {self._kind()} against the source:"]
            lines += [f"  mean {quality_text(quality.mean.between)}"]
            lines += [f"  worst {quality_text(quality.worst.between)}"]
            lines += [f"    in {shortened(quality.worst.name, 30)}"]
        return "\n".join(lines)

    def _kind(self) -> str:
        """Description of the measured views."""
        trials = self._viewer.encoding.trials
        cameras = () if trials is None else trials.cameras
        if not cameras:
            return "estimated views"
        held_out = any(camera.split == "test" for camera in cameras)
        return "held-out views" if held_out else "views"


def _line(entry: Trial | Opened) -> str:
    """A line of the list."""
    if isinstance(entry, Opened):
        size = "" if entry.file_bytes is None else f"  {_short(entry.file_bytes)}"
        return f"{shortened(entry.name, 24)}{size}"
    report, quality = entry.report, entry.quality
    line = f"{entry.name}  {_short(report.file_bytes)}  {report.ratio:.3g}x"
    if quality is None:
        return line
    psnr = quality.mean.between.psnr
    return f"{line}  the same" if math.isinf(psnr) else f"{line}  {psnr:.2f} dB"


def _short(size: int) -> str:
    """A size in bytes with a unit: a whole number or three digits."""
    number, unit = size_text(size).split()
    return f"{float(number):{'.3g' if float(number) < 999.5 else '.0f'}} {unit}"
