"""Charts below the panes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gs_codec.edit import statistics
from gs_codec.edit.description import statistics_of
from gs_codec.formats.cloud import to_cloud
from samples.generate import generate
from viewer.pictures.charts import (
    SCENES,
    ContactSheet,
    HistogramChart,
    Message,
    QualityChart,
    decibels,
)
from viewer.scenes.opened import Opened
from viewer.window.dock import Dock

SIZE = (700, 170)


def colours(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Pixel columns with a colour."""
    return np.flatnonzero((np.abs(255 * image - colour) < 1).all(axis=2).any(axis=0))


def test_bars_are_sorted_and_found_where_they_are_drawn():
    chart = QualityChart(["a", "b", "c"], {0: 40.0, 1: 33.0, 2: np.inf}, here=1)
    assert chart.order == [1, 0, 2]
    image = chart.draw(*SIZE)
    assert image.shape == (170, 700, 3)
    assert 0 <= image.min() < image.max() <= 1
    bars = colours(image[:-25], (230, 159, 0))  # orange: charts that are not shown
    assert {chart.view_at(x, SIZE[0]) for x in bars} == {0, 2}
    heights = [
        int((np.abs(255 * image[:, x] - (230, 159, 0)) < 1).all(axis=1).sum())
        for x in (bars[0], bars[-1])
    ]
    assert heights[1] > heights[0]
    assert chart.view_at(0, SIZE[0]) is None
    assert chart.view_at(SIZE[0] - 1, SIZE[0]) is None


@pytest.mark.parametrize("decibels", [{}, {0: np.inf}, {1: 33.0}, {0: 30.0, 1: 30.0}])
def test_few_or_equal_qualities_are_drawn(decibels):
    chart = QualityChart(["a", "b"], decibels)
    assert chart.draw(*SIZE).std() > 0
    assert chart.view_at(300, SIZE[0]) in {None, *decibels}


def test_equal_and_tiny_views_are_told_apart_and_not_in_the_mean():
    chart = QualityChart(["a", "b", "c", "d"], {0: np.nan, 1: 33.0, 2: np.inf, 3: 35.0})
    assert chart.order == [1, 3, 2]
    assert chart.draw(*SIZE).std() > 0
    expected = "worst 33.00 dB (b), mean 34.00 dB (line), 1 the same."
    assert expected in chart._caption()
    assert "worst the same (a)." in QualityChart(["a"], {0: np.inf})._caption()
    tiny = QualityChart(["a"], {0: np.nan})
    assert "too small" in tiny._caption()
    assert tiny.draw(*SIZE).std() > 0
    assert decibels(np.nan) == "too small"


def test_views_are_found_where_their_pictures_are():
    pictures = {1: np.full((20, 30, 3), (1, 0, 0), np.float32)}
    sheet = ContactSheet(["a", "b", "c", "d"], pictures, here=1)
    red = colours(sheet.draw(*SIZE), (255, 0, 0))
    assert {sheet.view_at(x, SIZE[1]) for x in red} == {1}
    assert sheet.view_at(5000, SIZE[1]) is None
    assert sheet.scrolled(-3, *SIZE) == 0
    assert 0 < sheet.scrolled(99, *SIZE) < 4


def test_a_histogram_has_one_axis_for_both_scenes_and_values_by_column():
    scenes = [statistics_of(generate(500, 1, seed)) for seed in (1, 2)]
    for name in ("opacity", "longest scale"):
        both = [next(a for a in s.attributes if a.name == name) for s in scenes]
        chart = HistogramChart(both)
        assert chart.selects
        ends = [chart.value_at(x, SIZE[0]) for x in (0, SIZE[0])]
        assert ends[0] == pytest.approx(min(s.edges[0] for s in both))
        assert ends[1] == pytest.approx(max(s.edges[-1] for s in both))
        chosen = tuple(chart.value_at(x, SIZE[0]) for x in (200, 400))
        marked = HistogramChart(both, chosen).draw(*SIZE)
        columns = colours(marked, (75, 75, 60))
        assert columns.min() == pytest.approx(200, abs=1)
        assert columns.max() == pytest.approx(400, abs=1)


def test_a_range_dragged_beyond_the_axis_has_no_end():
    found = statistics_of(generate(500, 1, 1)).attributes
    chart = HistogramChart([next(a for a in found if a.name == "longest scale")])
    middle, wide = 300, SIZE[0]
    value = chart.value_at(middle, wide)
    assert chart.between(wide, middle, wide) == (value, np.inf)
    assert chart.between(middle, 0, wide) == (-np.inf, value)
    assert np.isfinite(chart.between(200, middle, wide)).all()
    assert HistogramChart(chart.scenes, (-np.inf, np.inf)).draw(*SIZE).std() > 0


def test_attributes_of_several_values_select_nothing():
    found = statistics_of(generate(200, 1, 3)).attributes
    band = HistogramChart([next(a for a in found if a.name == "SH band 1")])
    assert not band.selects
    assert band.draw(*SIZE).std() > 0


@pytest.mark.parametrize("having", [0, 1])
def test_a_histogram_of_an_attribute_of_one_scene_has_the_colour_of_that_scene(having):
    degrees = [having == k for k in range(2)]
    scenes = [Opened(f"{k}", to_cloud(generate(200, int(d), 3))) for k, d in enumerate(degrees)]
    dock = object.__new__(Dock)
    dock._viewer = SimpleNamespace(stage=SimpleNamespace(scenes=scenes))
    dock._statistics = {s: {a.name: a for a in statistics(s.cloud).attributes} for s in scenes}
    dock.chart = Message("")
    drawn = dock._histogram("SH band 1").draw(*SIZE)
    assert [len(colours(drawn, SCENES[k])) > 50 for k in range(2)] == degrees
    assert isinstance(dock._histogram("SH band 2"), Message)


def test_tiny_and_empty_charts_are_drawn():
    nothing = statistics_of(generate(0, 0, 1)).attributes
    for chart in (HistogramChart([nothing[0]]), QualityChart([], {}), Message("x")):
        assert chart.draw(20, 12).shape == (12, 20, 3)
