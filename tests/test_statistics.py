"""Scene statistics against sorting and counting, and the output of `gs-codec inspect`."""

from __future__ import annotations

import io
import json
import math
import sys
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from command_line import strict_json
from scenes import (
    antialiased,
    assert_same_floats,
    edge_scenes,
    random_scene,
    shared_scene_path,
    with_threads,
)

from gs_codec.batch.needed_memory import needed_bytes
from gs_codec.cli.output import bars
from gs_codec.config import Config
from gs_codec.edit.description import BINS, Statistics, statistics_of
from gs_codec.edit.distribution import finite_values, histogram, ranked
from gs_codec.edit.shares import shares_of
from gs_codec.files.scenes import read_scene
from gs_codec.files.writing import write_scene
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene

SHARES = ("transparent", "needle-like", "huge", "same centre", "duplicate", "not finite")


def broken_scene() -> Scene:
    """NaN and infinity in every attribute, zeros of both signs, repeated Gaussians, properties."""
    base = random_scene(700, 3, seed=11)
    rng = np.random.default_rng(11)
    for group in GROUPS:
        planes = getattr(base, group)
        for value in (np.nan, -np.nan, np.inf, -np.inf):
            planes[rng.integers(0, len(planes), 6), rng.integers(0, 600, 6)] = value
    base.positions[:, 600:610] = 0.0
    base.positions[1, 605:610] = -0.0
    base.rot[:, 620] = 0.0
    extra = {
        "label": rng.integers(0, 2**32, 700, dtype=np.uint32),
        "level": rng.integers(-128, 128, 700).astype(np.int8),
        "far": np.where(np.arange(700) % 2, 1.7e308, -1.7e308),
        "tiny": np.full(700, 5e-324),
        "gap": rng.choice([np.nan, np.inf, -np.inf, 1.5, 2.5], 700),
    }
    scene = replace(base, extra=extra)
    return scene.take(np.r_[0:700, 0:20, 600:605, 700 - 5 : 700])


def all_nan() -> Scene:
    scene = random_scene(30, 1)
    return replace(scene, **{g: np.full_like(getattr(scene, g), np.nan) for g in GROUPS})


SCENES = {
    **edge_scenes(),
    **{f"degree {degree}": random_scene(5000, degree, seed=degree) for degree in range(4)},
    "broken": broken_scene(),
    "all NaN": all_nan(),
}


def stored_attributes(scene: Scene) -> dict[str, tuple]:
    """Each attribute by name: unit, stored values in 64 bits, and natural units of them."""

    def scaled(values):
        return np.exp(np.clip(values, -708, 709))

    def coloured(values):
        return 0.5 + 0.28209479177387814 * values

    def opaque(values):
        with np.errstate(over="ignore"):
            return 1 / (1 + np.exp(-values))

    wide = {group: getattr(scene, group).astype(np.float64) for group in GROUPS}
    sizes, count = np.sort(wide["log_scale"], axis=0), SH_COEFFICIENTS[scene.sh_degree]
    names = {
        "longest scale": ("scene units", sizes[2], scaled),
        "middle scale": ("scene units", sizes[1], scaled),
        "shortest scale": ("scene units", sizes[0], scaled),
        "opacity": ("0-1", wide["opacity"][0], opaque),
        "rotation norm": ("1", np.sqrt((wide["rot"] ** 2).sum(axis=0)), np.array),
    }
    for i in range(3):
        names["xyz"[i]] = ("scene units", wide["positions"][i], np.array)
        names[("red", "green", "blue")[i]] = ("0-1", wide["f_dc"][i], coloured)
    for degree in range(1, scene.sh_degree + 1):
        rows = [
            wide["f_rest"][colour * count + i]
            for colour in range(3)
            for i in range(degree**2 - 1, (degree + 1) ** 2 - 1)
        ]
        names[f"SH band {degree}"] = ("SH", np.concatenate(rows), np.array)
    for name, column in scene.extra.items():
        names[name] = (column.dtype.name, column.astype(np.float64), np.array)
    return names


@pytest.mark.parametrize("name", SCENES)
def test_attributes_are_those_of_sorted_values(name):
    scene = SCENES[name]
    expected, found = stored_attributes(scene), statistics_of(scene).attributes
    assert sorted(one.name for one in found) == sorted(expected)
    for one in found:
        unit, stored, natural = expected[one.name]
        assert one.unit == unit
        assert (one.nan, one.infinite) == (np.isnan(stored).sum(), np.isinf(stored).sum())
        finite = np.sort(stored[np.isfinite(stored)])
        values = natural(finite)
        if not len(finite):
            assert (one.minimum, one.low, one.median, one.high, one.maximum) == (None,) * 5
            assert (one.counts, one.edges, one.below, one.above) == ((), (), 0, 0)
            continue
        rank = (len(values) - 1) // 100
        middle = values[[(len(values) - 1) // 2, len(values) // 2]] / 2
        np.testing.assert_allclose(
            [one.minimum, one.low, one.median, one.high, one.maximum],
            [values[0], values[rank], middle.sum(), values[-1 - rank], values[-1]],
            rtol=1e-12,
        )
        assert one.below + sum(one.counts) + one.above == len(values)
        assert len(one.counts) == BINS == len(one.edges) - 1
        assert np.isfinite(one.edges).all()


@pytest.mark.parametrize("degree", range(4))
def test_histograms_are_those_of_numpy(degree):
    scene = random_scene(5000, degree, seed=20 + degree)
    expected = stored_attributes(scene)
    for one in statistics_of(scene).attributes:
        _, stored, natural = expected[one.name]
        # Bins of scales are evenly spaced in the logarithm, all others in natural units.
        logarithmic = one.name.endswith("scale")
        values = np.sort(stored if logarithmic else natural(stored))
        low, high = values[(len(values) - 1) // 100], values[-1 - (len(values) - 1) // 100]
        counts, edges = np.histogram(values, BINS, (low, high))
        assert one.counts == tuple(counts)
        assert (one.below, one.above) == ((values < low).sum(), (values > high).sum())
        np.testing.assert_allclose(one.edges, np.exp(edges) if logarithmic else edges, rtol=1e-12)


def test_histograms_of_nearly_one_value():
    column = np.zeros(1000)
    scene = replace(random_scene(1000, 0), extra={"mask": column.copy(), "flat": column + 3.0})
    scene.extra["mask"][:4] = (-1.0, 1.0, 1.0, 3.0)
    mask, flat = statistics_of(scene).attributes[-2:]
    assert (mask.low, mask.high, mask.edges[0], mask.edges[-1]) == (0, 0, -1, 3)
    assert {i: n for i, n in enumerate(mask.counts) if n} == {0: 1, 10: 996, 20: 2, 39: 1}
    assert (flat.edges[0], flat.edges[-1], max(flat.counts)) == (1.5, 4.5, 1000)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("number", [1, 2, 3, 1000])
def test_ranked_values_are_those_of_a_sort(dtype, number):
    rng = np.random.default_rng(number)
    planes = [rng.standard_cauchy(number).astype(dtype) ** 7 for _ in range(3)]
    planes[1][0], planes[2][-1] = np.finfo(dtype).max, -np.finfo(dtype).smallest_subnormal
    odd = np.array([np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0], dtype)
    planes = [*planes, odd, np.repeat(planes[0], 2)[::2]]
    together = np.concatenate(planes)
    expected = np.sort(together[np.isfinite(together)]).astype(np.float64)
    ranks = sorted({0, 1, len(expected) // 3, len(expected) // 2, len(expected) - 1})
    np.testing.assert_array_equal(ranked(finite_values(planes), ranks), expected[ranks])
    np.testing.assert_array_equal(ranked(finite_values(planes), ranks[::-1]), expected[ranks[::-1]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("span", [(0.0, 40.0), (-3.0, 7.0), (0.1, 0.1001)])
def test_bins_include_their_lower_edges(dtype, span):
    rng = np.random.default_rng(5)
    values = np.concatenate([np.linspace(*span, 41), rng.uniform(span[0] - 1, span[1] + 1, 500)])
    counts, edges = histogram(values := values.astype(dtype), *span, 40)
    numbers, bins = values.astype(float).tolist(), list(pairwise(edges.tolist()))
    assert counts[0] == sum(number < span[0] for number in numbers)
    assert counts[-1] == sum(number > span[1] for number in numbers)
    inside = [sum(low <= number < high for number in numbers) for low, high in bins]
    inside[-1] += numbers.count(bins[-1][1])
    assert counts[1:-1] == inside


def test_edges_end_with_the_largest_float():
    largest = sys.float_info.max
    for low, high in ((-largest, largest), (largest, largest), (5e-324, 5e-324), (0.0, 0.0)):
        counts, edges = histogram(np.array([low, high]), low, high, 40)
        assert np.isfinite(edges).all()
        assert (np.diff(edges) >= 0).all()
        assert sum(counts) == 2


def counted_shares(scene: Scene) -> dict[str, int]:
    """Brute-force counts for `shares_of`."""
    spans = []
    for row in scene.positions.astype(np.float64):
        finite = np.sort(row[np.isfinite(row)])
        rank = (len(finite) - 1) // 100
        spans.append(finite[-1 - rank] - finite[rank] if len(finite) else 0.0)
    extent, found = max(spans), Counter()
    centres, everything = Counter(), Counter()
    for i in range(scene.count):
        values = {group: getattr(scene, group)[:, i] for group in GROUPS}
        logit = float(values["opacity"][0])
        found["transparent"] += logit < -math.log(254)
        scales = [float(value) for value in values["log_scale"]]
        if not any(map(math.isnan, scales)):
            _, middle, longest = sorted(scales)
            found["needle-like"] += longest - middle > math.log(10)
            found["huge"] += bool(extent) and longest > math.log(extent / 20)
        words = {group: bytes(value + np.float32(0)) for group, value in values.items()}
        centres[words["positions"]] += 1
        everything[tuple(words.values())] += 1
        # Opacities of 0 and 1, and scales of 0.
        values["opacity"] = np.nan_to_num(values["opacity"], nan=np.nan)
        values["log_scale"] = np.nan_to_num(values["log_scale"], nan=np.nan, posinf=np.inf)
        found["not finite"] += not all(np.isfinite(value).all() for value in values.values())
    found["same centre"] = scene.count - len(centres)
    found["duplicate"] = scene.count - len(everything)
    return {name: found[name] for name in SHARES}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", SCENES)
def test_shares_are_counted(name):
    scene = SCENES[name]
    found = shares_of(scene)
    assert {one.name: one.count for one in found} == counted_shares(scene)
    assert tuple(one.name for one in found) == SHARES
    assert [one.share for one in found] == [one.count / max(scene.count, 1) for one in found]
    assert statistics_of(scene).shares == found


def test_shares_by_their_limits():
    scene = random_scene(1000, 0, seed=4)
    scene.positions[:] = 0.0
    scene.positions[0] = np.linspace(0, 1000, 1000)
    extent = scene.positions[0, 990] - scene.positions[0, 9]
    scene.log_scale[:] = 0.0
    scene.opacity[:] = 0.0
    scene.log_scale[1, :3] = np.log([9.99, 10.01, 0.05])
    scene.log_scale[:, 3] = math.log(0.0499 * extent)
    scene.log_scale[2, 4] = math.log(0.0501 * extent)
    scene.opacity[0, 5:9] = np.log([0.99 / 254, 1.01 / 254, 1e-9, 1e9])
    found = {one.name: one for one in shares_of(scene)}
    assert found["needle-like"].count == 2
    assert found["huge"].count == 1
    assert found["transparent"].count == 2
    assert "5 % of the scene's extent, 982" in found["huge"].rule


def test_repeated_gaussians():
    scene = random_scene(50, 3, seed=6)
    three = scene.take(np.r_[0:50, 0:50, 7])
    three.f_rest[44, 60] += 1
    three.rot[:, 61] *= -1
    counts = {one.name: one.count for one in shares_of(three)}
    assert (counts["same centre"], counts["duplicate"]) == (51, 49)


@pytest.mark.parametrize("name", SCENES)
def test_statistics_are_json(name):
    scene = SCENES[name]
    statistics = statistics_of(scene)
    plain = statistics.as_dict()
    again = json.loads(json.dumps(plain, allow_nan=False))
    assert [one["name"] for one in again["attributes"]] == [a.name for a in statistics.attributes]
    assert plain["count"] == scene.count
    assert plain["sh_degree"] == scene.sh_degree
    assert plain["raw_bytes"] == sum(getattr(scene, group).nbytes for group in GROUPS)
    assert plain["raw_bytes"] == plain["bytes_per_gaussian"] * scene.count
    finite = scene.positions[:, np.isfinite(scene.positions).all(axis=0)]
    if finite.size:
        np.testing.assert_array_equal(plain["bounds"], [finite.min(axis=1), finite.max(axis=1)])
    else:
        assert plain["bounds"] is None


def test_statements_in_comments():
    scene = random_scene(5)
    assert (statistics_of(scene).coordinates, statistics_of(scene).antialiased) == (None, False)
    assert statistics_of(antialiased(scene)).antialiased
    stated = replace(scene, comments=("CoordinateSystem: RUB",))
    assert statistics_of(stated).coordinates == "RUB"


def test_statistics_depend_only_on_values_and_change_nothing():
    scene, same = broken_scene(), broken_scene()
    planes = {group: np.asfortranarray(getattr(scene, group)) for group in GROUPS}
    found = [
        with_threads(1, statistics_of, scene),
        with_threads(3, statistics_of, scene),
        statistics_of(replace(scene, **planes)),
    ]
    assert found[0] == found[1] == found[2]
    assert_same_floats(scene, same)


def test_real_scenes():
    scene = read_scene(shared_scene_path("tiny_sh3.ply"))
    found = {one.name: one.count for one in shares_of(scene)}
    assert found == counted_shares(scene)
    assert found["same centre"] == 319


# The command


def rows_of(out: str) -> dict[str, list[str]]:
    """Lines of the attribute table, split at double spaces, by attribute."""
    table = out.split("\n\n")[1].splitlines()
    return {line.split("  ")[0]: line.split() for line in table[1:]}


def same_statistics(shown: dict, statistics: Statistics) -> None:
    named = json.dumps(statistics.as_dict()).replace('"count":', '"gaussians":')
    for name, value in json.loads(named).items():
        assert shown[name] == value, name
    assert shown["encoding_bytes"] == needed_bytes(statistics.raw_bytes)


@pytest.mark.parametrize("file", ["scene.ply", "scene.egs", "a.splat", "bad.ply", "none.ply"])
def test_inspect_shows_statistics(folder, file):
    write_scene("a.splat", read_scene("scene.ply"), Config())
    write_ply("bad.ply", broken_scene())
    write_ply("none.ply", random_scene(0, 1))
    status, out, err = folder.run("inspect", file, "--histogram")
    assert (status, err) == (0, "")
    statistics = statistics_of(read_scene(file, "keep", coordinates=None))
    assert out.startswith(folder.run("inspect", file).out.split("of the Gaussians")[0])
    rows = rows_of(out)
    assert list(rows) == [one.name for one in statistics.attributes]
    for one in statistics.attributes:
        cells = rows[one.name][len(one.name.split()) + 1 :]
        assert cells[5:7] == [f"{one.nan:,}", f"{one.infinite:,}"]
        if one.median is None:
            assert cells[:5] == ["-"] * 5
        else:
            assert float(cells[2]) == pytest.approx(
                one.median, rel=6e-3, abs=1e-4 * max(-one.minimum, one.maximum)
            )
    for share in statistics.shares:
        line = next(line for line in out.splitlines() if line.startswith(share.name))
        assert f" {share.count:,} " in line
        assert line.endswith(share.rule)
    assert f"memory: {statistics.bytes_per_gaussian} bytes per Gaussian" in out.splitlines()[-1]
    shown = strict_json(folder.run("inspect", file, "--histogram", "--json").out)
    same_statistics(shown, statistics)
    plain = strict_json(folder.run("inspect", file, "--json").out)
    assert plain | {"seconds": shown["seconds"]} == {name: shown[name] for name in plain}
    assert ("shares" in plain) == (not file.endswith(".egs"))


def test_inspect_fits_into_a_hundred_columns(folder):
    for file in ("scene.ply", "scene.egs"):
        lines = folder.run("inspect", file, "--histogram").out.split("\n\n", 1)[1].splitlines()
        assert max(map(len, lines)) <= 100


def test_inspect_reports_the_shares_of_a_scene(folder):
    write_ply("bad.ply", broken_scene())
    out = folder.run("inspect", "bad.ply").out
    line = next(line for line in out.splitlines() if line.startswith("of the Gaussians: "))
    shares = shares_of(broken_scene())
    told = [f"{100 * s.share:.2f} % {s.name}" for s in shares if s.count]
    assert line == "of the Gaussians: " + ", ".join(told)
    write_ply("none.ply", random_scene(0))
    assert "of the Gaussians" not in folder.run("inspect", "none.ply").out


def test_a_small_share_is_not_shown_as_zero(folder):
    scene = random_scene(30_000, 0, seed=9)
    scene.opacity[:] = 1.0
    scene.opacity[0, 0] = -20.0
    write_ply("many.ply", scene)
    assert "<0.01 % transparent" in folder.run("inspect", "many.ply").out


def test_inspect_reads_blocks_only_for_statistics(folder):
    data = bytearray((folder.path / "scene.egs").read_bytes())
    data[-100] ^= 1
    (folder.path / "damaged.egs").write_bytes(data)
    assert folder.run("inspect", "damaged.egs").status == 0
    assert "checksum" in folder.refuse("inspect", "damaged.egs", "--histogram")


def test_inspect_refuses_options_without_effect(folder):
    assert "--max-bytes" in folder.refuse("inspect", "scene.egs", "--max-bytes", "1000000")
    assert folder.run("inspect", "scene.egs", "--histogram", "--max-bytes", "1000000").status == 0
    for file in ("scene.egs", "scene.ply"):
        error = folder.refuse("inspect", file, "--histogram", "--max-bytes", "1000")
        assert "354,000 bytes" in error
        assert "1,000" in error
    assert "--channels" in folder.refuse("inspect", "scene.ply", "--histogram", "--channels")
    out = folder.run("inspect", "scene.egs", "--histogram", "--channels").out
    assert {"f_rest_44", "longest scale"} <= {
        line.split("  ")[0] for line in out.splitlines() if line
    }


def test_histograms_in_blocks_and_in_ascii(monkeypatch):
    counts = [0, 1, 10, 50, 80]
    assert bars(counts) == " ▁▁▅█"
    assert bars([]) == ""
    assert bars([0, 0]) == "  "
    for encoding in ("ascii", "cp1252"):
        stream = io.TextIOWrapper(io.BytesIO(), encoding)
        monkeypatch.setattr(sys, "stdout", stream)
        shown = bars(counts)
        monkeypatch.undo()
        assert shown == " ..+#"
    assert bars([10**15, 1]) == "█▁"


def test_a_terminal_without_blocks_shows_ascii(folder):
    stream = io.TextIOWrapper(io.BytesIO(), "ascii")
    folder.monkeypatch.setattr(sys, "argv", ["gs-codec", "inspect", "scene.ply", "--histogram"])
    folder.monkeypatch.setattr(sys, "stdout", stream)
    from gs_codec.cli import main as cli

    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code
    out = stream.buffer.getvalue().decode("ascii")
    assert "\\u" not in out
    assert "#" in rows_of(out)["x"][-1]
