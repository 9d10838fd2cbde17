"""The analysis of a scene: statistics of known distributions, and the report on them."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import Folder, strict_json
from scenes import edge_scenes, random_scene, thorough

from gs_codec.analysis import plots
from gs_codec.analysis.analyse import analyse_scene
from gs_codec.analysis.entropy import bits_by_attribute, depths_by_group, entropy_by_group
from gs_codec.analysis.fits import fits_of
from gs_codec.analysis.information import bin_count, into_bins, mutual_information
from gs_codec.analysis.maps import maps_of, mean_by_attribute, mean_by_relation
from gs_codec.analysis.plots import draw_pictures, plot_sensitivity
from gs_codec.analysis.sensitivity_curves import (
    LEVELS,
    SCALES,
    THRESHOLD,
    level_at,
    measure_sensitivity,
)
from gs_codec.codecs import encode_scene
from gs_codec.codecs.entropygs.symbols import Coded, order_scene, quantise_and_model
from gs_codec.config import PROFILE_CHOICES, PROFILES, Config
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.pages.figures import new_figure, png_of
from gs_codec.pages.html import page, picture
from gs_codec.pages.tables import Table
from gs_codec.views.estimate import auto_cameras

GROUPS = {
    "positions",
    "SH-DC",
    "SH-AC, degree 1",
    "opacity",
    "scaling",
    "rotation",
    "the rest",
}


def information_of(first, second, seed=0):
    bins = bin_count(first.shape[1])
    codes = into_bins(first, bins), into_bins(second, bins)
    return mutual_information(*codes, bins, np.random.default_rng(seed))


def coded_of(scene, config) -> Coded:
    """Symbols and models, as in `encode_scene`."""
    depths = config.resolved_depths()
    order = order_scene(scene, depths).order
    return quantise_and_model(scene, order, config)


def histograms_of(coded: Coded) -> dict[str, np.ndarray]:
    """Histograms of the symbols of varying channels, by name."""
    names = [channel.name for channel in coded.channels if channel.model]
    return dict(zip(names, map(np.bincount, coded.symbols), strict=True))


#: Edge scenes that are difficult for statistics.
ODD = (
    "one",
    "two",
    "identical",
    "one place",
    "SH-AC outlier",
    "denormal positions",
    "huge range",
    "two opacities",
    "sparse SH-AC",
    "zero SH-AC",
    "all colours constant",
    "negative zero",
)


# Mutual information


@pytest.mark.parametrize("count", [3000, 30000])
def test_independent_channels_have_no_information(count):
    rng = np.random.default_rng(1)
    first, second = rng.laplace(size=(6, count)), rng.laplace(size=(8, count))
    found = information_of(first, second)
    assert found.corrected.shape == (6, 8)
    # Without correction, they seem dependent; the correction leaves random noise of either sign.
    assert found.raw.min() > 0
    assert abs(found.corrected.mean()) < 0.2 * found.raw.mean()
    assert np.abs(found.corrected).max() < found.raw.max()


def test_equal_channels_have_full_information():
    values = np.random.default_rng(2).normal(size=(3, 5000))
    found = information_of(values, np.exp(-values))
    np.testing.assert_allclose(np.diag(found.corrected), 1.0)
    np.testing.assert_allclose(np.diag(found.raw), 1.0)
    assert np.abs(found.corrected[~np.eye(3, dtype=bool)]).max() < 0.01


def test_information_equals_that_of_the_joint_table():
    from scipy.stats import entropy

    rng = np.random.default_rng(3)
    first = rng.normal(size=4000)
    second = first + rng.normal(size=4000)
    bins = 8
    codes = into_bins(np.stack([first, second]), bins)
    both = np.zeros((bins, bins))
    np.add.at(both, (codes[0], codes[1]), 1)
    p = both / both.sum()
    product = p.sum(axis=1, keepdims=True) * p.sum(axis=0, keepdims=True)
    information = np.sum(p[p > 0] * np.log(p[p > 0] / product[p > 0]))
    expected = 2 * information / (entropy(p.sum(axis=0)) + entropy(p.sum(axis=1)))
    found = mutual_information(codes[:1], codes[1:], bins, np.random.default_rng(0))
    assert found.raw[0, 0] == pytest.approx(expected, rel=1e-12)
    assert found.corrected[0, 0] == pytest.approx(expected, abs=0.02)


def test_bins_have_equal_counts_and_equal_values_share_one():
    rng = np.random.default_rng(4)
    values = rng.laplace(size=(1, 6400)).astype(np.float32)
    assert np.bincount(into_bins(values, 32)[0]).tolist() == [200] * 32
    values[0, :3000] = 0
    codes = into_bins(values, 32)[0]
    assert len(np.unique(codes[values[0] == 0])) == 1
    order = np.argsort(values[0], kind="stable")
    assert np.all(np.diff(codes[order]) >= 0)


def test_bins_of_equal_widths_are_those_of_a_histogram():
    rng = np.random.default_rng(20)
    values = rng.uniform(-3, 5, (1, 20000)).astype(np.float32)
    low, high = np.quantile(values, (0.001, 0.999), method="nearest")
    inner = values[(values >= low) & (values <= high)]
    counts = np.bincount(into_bins(values, 16, "widths")[0], minlength=16)
    expected = np.histogram(inner, 16, (low, high))[0]
    assert counts.sum() == 20000
    assert np.array_equal(counts[1:-1], expected[1:-1])
    # The few values beyond the quantiles fall into the outermost bins.
    assert np.all(counts[[0, -1]] == expected[[0, -1]] + [20, 20])


def test_outliers_do_not_put_all_other_values_in_one_bin():
    values = np.random.default_rng(21).normal(size=(1, 10000)).astype(np.float32)
    values[0, :5] = [1e30, -1e30, 1e6, -1e6, 1e9]
    codes = into_bins(values, 16, "widths")[0]
    assert np.bincount(codes, minlength=16).max() < 0.2 * values.size
    assert codes[[0, 2, 4]].tolist() == [15] * 3
    assert codes[[1, 3]].tolist() == [0] * 2


def test_rare_values_next_to_a_frequent_one_have_equal_bins():
    values = np.zeros((2, 10000), np.float32)
    values[0, :3] = [1, 2, 4]  # both quantiles are 0
    codes = into_bins(values, 4, "widths")
    assert codes[0, :4].tolist() == [0, 1, 3, 0]
    assert not codes[1].any()


@pytest.mark.parametrize(
    ("count", "bins"), [(1, 2), (199, 2), (5000, 10), (51200, 32), (10**7, 32)]
)
def test_small_samples_have_few_bins(count, bins):
    assert bin_count(count) == bins


@pytest.mark.parametrize("count", [0, 1, 2, 100])
def test_constant_channels_have_no_information(count):
    constant = np.full((2, count), 3.0, np.float32)
    varying = np.arange(count, dtype=np.float32)[None]
    for found in (information_of(constant, varying), information_of(constant, constant)):
        assert not found.raw.any()
        assert not found.corrected.any()


def test_the_seed_determines_the_shuffle():
    values = np.random.default_rng(5).normal(size=(4, 500))
    once, again, other = (information_of(values, values, seed).bias for seed in (1, 1, 2))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)


def test_maps_show_injected_dependencies():
    scene = random_scene(5000, 1, seed=6)
    rest = scene.f_rest.copy()
    rest[3:6] = rest[:3] * 2  # green follows red, coefficient by coefficient
    scene = replace(scene, f_rest=rest, opacity=rest[7:8] + np.float32(1))
    counted = []
    maps = maps_of(scene, bin_count(5000), 0, lambda *step: counted.append(step))
    assert counted == [("mutual information", number, 8) for number in range(1, 9)]
    means = mean_by_relation(maps["sh-ac"])
    assert means["R and G, same coefficient"] == pytest.approx(1)
    assert means["R and B, same coefficient"] == pytest.approx(0, abs=0.01)
    assert means["R, different coefficients"] == pytest.approx(0, abs=0.01)
    others = mean_by_attribute(maps["sh-ac-others"])
    assert others["opacity"] == pytest.approx(1 / 9, abs=0.01)
    assert others["rotation"] == pytest.approx(0, abs=0.01)
    row = maps["sh-ac-others"].rows.index("opacity")
    for found in maps["sh-ac-others"].information.values():
        assert found.corrected[row].argmax() == 7
    by_widths = mean_by_relation(maps["sh-ac"], "widths")
    assert by_widths["R and G, same coefficient"] == pytest.approx(1)
    assert by_widths["R and B, same coefficient"] == pytest.approx(0, abs=0.01)
    assert mean_by_attribute(maps["sh-ac-others"], "widths") != others
    assert maps["sh-ac-others"].columns[7] == "B 2"


def test_gaussians_with_zero_sh_colours_are_distinguished():
    scene = random_scene(4000, 1, seed=7)
    rest = scene.f_rest.copy()
    rest[:3, :1000] = 1e-6  # a quarter of red is tiny, because some formats have no exact zero
    maps = maps_of(replace(scene, f_rest=rest), 8, 0)
    assert (maps["sh-ac"].gaussians, maps["sh-ac-coloured"].gaussians) == (4000, 3000)
    alike, other = (
        mean_by_relation(maps[name])["R, different coefficients"]
        for name in ("sh-ac", "sh-ac-coloured")
    )
    assert alike > 0.05
    assert abs(other) < 0.01


def test_luma_and_chroma_decorrelate_colours():
    scene = random_scene(5000, 0, seed=8)  # grey with a little of each colour
    maps = maps_of(scene, bin_count(5000), 0)
    off = ~np.eye(3, dtype=bool)
    before, after = (maps[n].information["counts"].corrected[off] for n in ("sh-dc", "sh-dc-ycocg"))
    assert before.min() > 0.3
    assert after.max() < 0.02


# Distributions


def channel_fit(scene, name, profile="paper-m"):
    return next(f for f in fits_of(scene, Config(profile)) if f.channel.name == name)


def test_a_known_mixture_is_recovered():
    rng = np.random.default_rng(9)
    weights, means, sigmas = [0.3, 0.7], [-4.0, 3.0], [0.5, 1.0]
    which = rng.random(40000) < weights[0]
    values = np.where(which, rng.normal(means[0], sigmas[0], 40000), rng.normal(means[1], 1, 40000))
    scene = replace(random_scene(40000, 0), opacity=values[None].astype(np.float32))
    fit = channel_fit(scene, "opacity")
    assert fit.model == "mixture"
    np.testing.assert_allclose(fit.parameters["weights"], weights, atol=0.01)
    np.testing.assert_allclose(fit.parameters["means"], means, atol=0.03)
    np.testing.assert_allclose(fit.parameters["sigmas"], sigmas, atol=0.03)
    assert fit.ks < 0.01
    assert 0 <= fit.kl_bits < 0.01
    x = np.linspace(-12, 12, 20001)
    assert np.trapezoid(fit.pdf(x), x) == pytest.approx(1, abs=1e-4)


def test_a_known_laplace_distribution_is_recovered():
    from scipy.stats import laplace

    rng = np.random.default_rng(10)
    scene = random_scene(30000, 1)
    scene = replace(scene, f_rest=rng.laplace(0.2, 0.05, (9, 30000)).astype(np.float32))
    fit = channel_fit(scene, "f_rest_4")
    assert fit.model == "laplace"
    assert fit.parameters["median"] == pytest.approx(0.2, abs=0.002)
    assert fit.parameters["scale"] == pytest.approx(0.05, rel=0.02)
    assert fit.ks < 0.01
    assert fit.zeros < 0.01
    assert fit.ks_nonzero == pytest.approx(fit.ks, abs=0.005)
    assert 0 <= fit.kl_bits < 0.02
    np.testing.assert_allclose(fit.pdf(np.array([0.1])), laplace.pdf(0.1, 0.2, 0.05), rtol=0.1)


def test_zeros_are_the_misfit_of_a_laplace_distribution():
    rng = np.random.default_rng(11)
    values = rng.laplace(0.0, 0.05, (9, 20000)).astype(np.float32)
    values[:, :6000] = 0
    fit = channel_fit(replace(random_scene(20000, 1), f_rest=values), "f_rest_0")
    assert fit.zeros == pytest.approx(0.3 + 0.7 * 0.01, abs=0.003)
    assert fit.ks > 0.13
    assert fit.ks_nonzero < 0.02


def test_bars_and_entropies_are_those_of_the_values():
    from scipy.stats import entropy

    scene = random_scene(3000, 1, seed=12)
    coded = coded_of(scene, Config("paper-m"))
    histograms = histograms_of(coded)
    for fit in fits_of(scene, Config("paper-m")):
        assert np.sum(fit.density * np.diff(fit.edges)) == pytest.approx(0.998, abs=0.002)
        if fit.channel.name in histograms:
            expected = entropy(histograms[fit.channel.name], base=2)
            assert fit.entropy_bits == pytest.approx(expected)
            assert fit.kl_bits >= -1e-3
    assert fit.as_dict()["depth"] == 4


# Tables


def test_the_entropy_table_is_that_of_the_symbols():
    from scipy.stats import entropy

    scene = random_scene(3000, 2, seed=13)
    config = Config("paper-s")
    _, report = encode_scene(scene, config)
    table = entropy_by_group(report)
    coded = coded_of(scene, config)
    members: dict[str, list[float]] = {}
    histograms = histograms_of(coded)
    for channel in (channel for channel in coded.channels if channel.model):
        name = "sh-ac" if channel.stream.startswith("sh") else channel.stream
        members.setdefault(name, []).append(float(entropy(histograms[channel.name], base=2)))
    assert set(table) == {*members, "total"}
    shared = report.section_bytes["states"] + report.section_bytes["channels"]
    sizes = {name: report.section_bytes[name] for name in ("opacity", "scaling", "rotation")}
    sizes["sh-ac"] = report.section_bytes["sh1"] + report.section_bytes["sh2"]
    for name, entropies in members.items():
        known = table[name]
        share = shared * len(entropies) / len(report.costs)
        bits = 8 * (sizes[name] + share) / (3000 * len(entropies))
        assert known["bits_per_symbol"] == pytest.approx(np.mean(entropies))
        assert known["coded_bits_per_symbol"] == pytest.approx(bits)
        expected = 100 * (bits / np.mean(entropies) - 1)
        assert known["coded_overhead_percent"] == pytest.approx(expected)
    assert depths_by_group(config, 2)["sh-ac"] == "4/3"
    assert depths_by_group(Config("paper-m"), 3)["sh-ac"] == "4"


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_bits_of_attributes_add_up_to_the_file(profile):
    data, report = encode_scene(random_scene(800, 1, seed=14), Config(profile))
    bits = bits_by_attribute(report, 1)
    assert set(bits) == GROUPS
    assert sum(bits.values()) * 800 == pytest.approx(8 * len(data))
    assert bits["positions"] > 8
    assert all(value >= 0 for value in bits.values())


# Sensitivity


@pytest.fixture(scope="module")
def measured():
    scene = random_scene(1500, 1, seed=15)
    cameras = [camera.resized(60, 40) for camera in auto_cameras(scene, 2)]
    steps = []
    counted = {"progress": lambda *s: steps.append(s)}
    found = measure_sensitivity(scene, cameras, Config("paper-m"), 3, **counted)
    return scene, cameras, found, steps


@pytest.mark.thorough
def test_larger_errors_lower_the_quality(measured):
    _, _, found, steps = measured
    names = {"positions", "SH-DC", "SH-AC", "opacity", "scaling", "rotation"}
    assert {curve.attribute for curve in found.curves} == names
    for curve in found.curves:
        assert curve.psnr[0] > 60
        assert curve.psnr[0] > curve.psnr[4] > curve.psnr[8]
        assert 0 < curve.profile_error < 1
        assert curve.errors == LEVELS
        if curve.tolerance is not None:
            low = max(i for i, q in enumerate(curve.psnr) if q >= THRESHOLD)
            assert LEVELS[0] <= curve.tolerance <= LEVELS[min(low + 1, len(LEVELS) - 1)]
            assert 0 < curve.tolerance_of_range < curve.tolerance
    assert steps[-1] == ("sensitivity", 6 * len(LEVELS), 6 * len(LEVELS))


def test_attributes_are_ordered_by_tolerance(measured):
    _, _, found, _ = measured
    known = [curve.tolerance for curve in found.ranked() if curve.tolerance is not None]
    assert known == sorted(known)
    content = found.as_dict()
    assert content["most_sensitive_first"] == [curve.attribute for curve in found.ranked()]
    assert set(content["curves"]) == set(content["most_sensitive_first"])


def test_the_lowest_level_bounds_the_tolerance():
    steep, flat = [20.0] * len(LEVELS), [90.0] * len(LEVELS)
    falling = [90.0] * 4 + [50.0, 30.0] + [10.0] * (len(LEVELS) - 6)
    assert level_at(THRESHOLD, tuple(steep)) == LEVELS[0]
    assert level_at(THRESHOLD, tuple(flat)) is None
    middle = level_at(THRESHOLD, tuple(falling))
    assert middle == pytest.approx(np.sqrt(LEVELS[4] * LEVELS[5]))


def test_the_same_seed_makes_the_same_noise(measured):
    scene, cameras, found, _ = measured
    again = measure_sensitivity(scene, cameras, Config("paper-m"), 3)
    assert again.as_dict() == found.as_dict()


def test_errors_over_the_mean_are_those_of_the_noise(measured):
    scene, cameras, found, _ = measured
    other = measure_sensitivity(scene, cameras, Config("paper-m"), 3, "mean")
    planes = {"SH-DC": scene.f_dc, "rotation": scene.rot, "positions": scene.positions}
    for ours, papers in zip(found.curves, other.curves, strict=True):
        assert papers.psnr == ours.psnr
        assert papers.tolerance_of_range == ours.tolerance_of_range
        if (values := planes.get(ours.attribute)) is not None:
            noise = np.random.default_rng(0).normal(size=values.shape)
            noise *= 0.1 * values.std(axis=1, keepdims=True)
            expected = np.mean(noise**2) / np.abs(values).mean()
            assert papers.errors[LEVELS.index(0.1)] == pytest.approx(expected, rel=0.05)
        # Reports mark the same points of the curve.
        unit = papers.errors[-1]
        assert papers.profile_error == pytest.approx(unit * ours.profile_error**2)
        if ours.tolerance is not None:
            assert papers.tolerance == pytest.approx(unit * ours.tolerance**2)


def test_the_error_scale_determines_the_order(measured):
    scene, cameras, found, _ = measured
    assert found.ranked()[0].attribute == "positions"
    # The unit of length changes absolute errors, but not errors in standard deviations.
    unit = np.float32(2**20)
    large = replace(
        scene, positions=scene.positions * unit, log_scale=scene.log_scale + np.log(unit)
    )
    views = [replace(camera, position=camera.position * unit) for camera in cameras]
    known = {
        scale: measure_sensitivity(large, views, Config("paper-m"), 3, scale) for scale in SCALES
    }
    ranks = {scale: found.ranked()[0].attribute for scale, found in known.items()}
    assert ranks["deviation"] == "positions"
    assert ranks["mean"] != "positions"
    for scale, found in known.items():
        assert found.as_dict()["error_scale"] == scale
        assert found.as_dict()["most_sensitive_first"][0] == ranks[scale]


@pytest.mark.thorough
def test_constant_attributes_have_no_error_over_the_mean():
    scene = random_scene(200, 1, seed=22)
    scene = replace(scene, f_rest=scene.f_rest * np.float32(0), opacity=scene.opacity * 0 + 1)
    cameras = [camera.resized(30, 20) for camera in auto_cameras(scene, 1)]
    found = measure_sensitivity(scene, cameras, Config("paper-m"), 3, "mean")
    errors = {curve.attribute: curve.errors for curve in found.curves}
    assert not any(errors["SH-AC"])
    assert not any(errors["opacity"])
    assert all(errors["rotation"])
    assert png_of(plot_sensitivity, found).startswith(b"\x89PNG")
    nothing = replace(found, curves=tuple(c for c in found.curves if not any(c.errors)))
    assert png_of(plot_sensitivity, nothing).startswith(b"\x89PNG")


# Whole scenes


@pytest.mark.thorough
@pytest.mark.parametrize("name", ODD)
def test_edge_scenes_are_analysed(name):
    analysis = analyse_scene(edge_scenes()[name], name)
    content = strict_json(json.dumps(analysis.as_dict()))
    assert content["gaussians"] == analysis.count
    assert set(content["bits_by_profile"]) == set(PROFILE_CHOICES)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["one", "five of degree 0", "huge range", "zero SH-AC"])
def test_edge_scenes_are_plotted(name):
    scene = edge_scenes()[name]
    analysis = analyse_scene(replace(scene, f_rest=scene.f_rest[:9]), name)
    for data in draw_pictures(analysis).values():
        assert data.startswith(b"\x89PNG")


def test_no_gaussians_are_refused():
    with pytest.raises(InvalidInput, match=r"^x: no Gaussians to analyse$"):
        analyse_scene(random_scene(0), "x")
    scene = random_scene(3, 0)
    bad = replace(scene, opacity=np.full_like(scene.opacity, np.nan))
    with pytest.raises(InvalidInput, match="all 3 contain NaN or infinity"):
        analyse_scene(bad, "x")


def test_omissions_are_reported():
    scene = random_scene(2000, 1, seed=16)
    opacity = scene.opacity.copy()
    opacity[0, 5] = np.nan
    constant = replace(scene, opacity=opacity, f_rest=scene.f_rest * np.float32(0))
    analysis = analyse_scene(constant, "x", sample=500, seed=4)
    assert (analysis.count, analysis.sampled) == (1999, 500)
    notes = "\n".join(analysis.notes)
    assert "1 Gaussian with NaN or infinity" in notes
    assert "500 of 1,999" in notes
    assert "seed 4" in notes
    assert "SH degree 1: higher bands are absent" in notes
    assert "f_rest_8" in notes


def test_missing_matplotlib_is_reported(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(MissingTool, match="matplotlib"):
        new_figure(1, 1)


# The page


def test_text_is_escaped():
    text = page("<&>", [Table(["<&>"], [["<&>"]]).html("<&>"), picture(b"x", '"<&>"')])
    assert "<&>" not in text
    assert text.count("&lt;&amp;&gt;") == 7


# The command


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys) -> Folder:
    monkeypatch.chdir(tmp_path)
    return Folder(tmp_path, monkeypatch, capsys)


@pytest.fixture
def no_ink(monkeypatch):
    """Make figures without rendering pixels, which takes longest."""
    monkeypatch.setattr(plots, "png_of", lambda plot, *args: plot(*args) and b"\x89PNG")


def test_numbers_without_plots_need_no_matplotlib(folder, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    write_ply(folder.path / "scene.ply", random_scene(300, 1, seed=17))
    before = folder.contents()
    status, out, _ = folder.run("analyze", "scene.ply", "--json")
    assert (status, json.loads(out)["pictures"]) == (0, [])
    assert folder.contents() == before
    assert "--overwrite" in folder.refuse("analyze", "scene.ply", "--json", "--overwrite")


@pytest.mark.usefixtures("few_cameras")
@pytest.mark.parametrize("degree", [thorough(0), 1, thorough(3)])
def test_command_writes_a_self_contained_report(folder, degree):
    write_ply(folder.path / "scene.ply", random_scene(600, degree, seed=17))
    views = ("--cameras", "auto", "--width", "40") if degree == 1 else ()
    status, out, err = folder.run("analyze", "scene.ply", "--out", "report", "--json", *views)
    assert status == 0, err
    assert "Only 600 Gaussians" in err
    content = strict_json(out)
    written = folder.path / "report"
    saved = strict_json((written / "report.json").read_text())
    assert content | saved == content
    assert set(saved) == {
        "gs_codec",
        "schema",
        "input",
        "gaussians",
        "sh_degree",
        "sample",
        "seed",
        "notes",
        "mutual_information",
        "channels",
        "entropy",
        "bits_by_profile",
        "sensitivity",
        "pictures",
    }
    assert (content["gaussians"], content["sh_degree"]) == (600, degree)
    assert set(content["entropy"]) == set(PROFILES)
    assert len(content["channels"]["fits"]) == 14 + 3 * (0, 3, 8, 15)[degree]
    assert (content["sensitivity"] is not None) == bool(views)
    assert ("sensitivity.png" in content["pictures"]) == bool(views)
    files = {path.name for path in written.iterdir()}
    assert files == {"report.html", "report.json", *content["pictures"]}
    text = (written / "report.html").read_text()
    assert not re.search(r"https?:|<script|<link|@import|url\(", text)
    sources = re.findall(r'src="([^"]{0,22})', text)
    assert sources == ["data:image/png;base64,"] * len(content["pictures"])
    assert ("SH degree 0: there are no SH-AC" in text) == (degree == 0)


@pytest.mark.thorough
@pytest.mark.usefixtures("no_ink")
def test_a_name_that_is_not_utf8_is_escaped_on_the_page(folder):
    name = os.fsdecode(b"a\xff.ply")
    write_ply(folder.path / name, random_scene(300, 0, seed=17))
    assert folder.run("analyze", name, "--out", "report").status == 0
    assert r"a\udcff.ply" in (folder.path / "report" / "report.html").read_text()


@pytest.mark.usefixtures("no_ink")
def test_command_prints_a_summary(folder):
    encoded, _ = encode_scene(random_scene(1500, 0, seed=18), Config("m"))
    (folder.path / "scene.egs").write_bytes(encoded)
    status, out, err = folder.run("analyze", "scene.egs", "--out", "report", "--sample", "900")
    assert status == 0
    assert "900 of 1,500" in err
    lines = out.splitlines()
    assert lines[0].endswith("1,500 Gaussians, SH degree 0")
    assert lines[1].split()[-7:] == list(PROFILE_CHOICES)
    assert lines[-1] == "report: report/report.html"
    again = folder.run("analyze", "scene.egs", "--out", "again", "--sample", "900")
    assert again.status == 0
    first, second = (
        (folder.path / name / "report.json").read_bytes() for name in ("report", "again")
    )
    assert first == second


@pytest.mark.thorough
@pytest.mark.usefixtures("no_ink")
def test_command_reports_relative_errors_and_both_kinds_of_bins(folder):
    write_ply(folder.path / "scene.ply", random_scene(600, 1, seed=23))
    given = ("analyze", "scene.ply", "--out", "report", "--cameras", "auto", "--width", "30")
    status, out, err = folder.run(*given, "--error-scale", "mean", "--json")
    assert status == 0, err
    content = strict_json(out)
    assert content["sensitivity"]["error_scale"] == "mean"
    curve = content["sensitivity"]["curves"]["rotation"]
    assert curve["errors"][-1] == pytest.approx(curve["errors"][0] * 1e10)
    text = (folder.path / "report" / "report.html").read_text()
    assert "paper, Section 3.3" in text
    assert "paper-m: MSE/mean" in text
    information = content["mutual_information"]
    for name, found in information["maps"].items():
        shape = len(found["rows"]), len(found["columns"])
        assert np.shape(found["counts"]["nmi"]) == np.shape(found["widths"]["nmi"]) == shape
        if name.startswith("sh-ac"):
            assert set(information["means"]["widths"][name]) == set(
                information["means"]["counts"][name]
            )
    assert "all, widths" in text
    line = folder.refuse(*given, "--error-scale", "median")
    assert "--error-scale median: expected deviation or mean" in line


def test_command_refuses_unusable_input(folder):
    write_ply(folder.path / "empty.ply", random_scene(0))
    write_ply(folder.path / "scene.ply", random_scene(50, 0))
    (folder.path / "file").write_text("")
    assert "no Gaussians to analyse" in folder.refuse("analyze", "empty.ply", "--out", "report")
    assert "missing.ply" in folder.refuse("analyze", "missing.ply", "--out", "report")
    assert "--out" in folder.refuse("analyze", "scene.ply")
    for option, value in (("--sample", "1"), ("--seed", "-1")):
        line = folder.refuse("analyze", "scene.ply", "--out", "report", option, value)
        assert f"'{option}'" in line
    assert "--width" in folder.refuse("analyze", "scene.ply", "--out", "report", "--width", "9")
    assert "file" in folder.refuse("analyze", "scene.ply", "--out", "file")
    assert "file" in folder.refuse("analyze", "scene.ply", "--out", "file/below")
    assert read_ply(folder.path / "scene.ply").count == 50
