"""Streamed SOG: tree and files, rejected input, and rendering by PlayCanvas."""

from __future__ import annotations

import json
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import foreign
import numpy as np
import pytest
from other_programs import PROGRAMS, check, stored_numbers
from PIL import Image
from scenes import SmallBlocks, assert_same_floats, random_scene
from typer.testing import CliRunner
from web_pages import SIZE, Job, decibels, drawn, in_browser, open_pages, seen, serving

from gs_codec.cameras.camera_files import write_cameras
from gs_codec.cli.main import app
from gs_codec.coding.morton import spatial_order
from gs_codec.config import Config
from gs_codec.errors import GsCodecError, InvalidInput, MissingTool
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.preparing import prepare_file
from gs_codec.files.scenes import read_scene
from gs_codec.format_table import STREAMED
from gs_codec.formats.coordinates import CONVENTION, state_system, turn_axes
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.registry import check_file, open_scene, overview_of
from gs_codec.levels.streaming import stream_levels
from gs_codec.plan import Plan, Steps
from gs_codec.runtime.atomic import write_files
from gs_codec.scene import ANTIALIASED, FLAT, Scene
from gs_codec.sequences.frame_sources import has_frames
from gs_codec.views.estimate import auto_cameras
from samples.generate import generate

LEAF, FILE = 200, 450
CONFIG = SmallBlocks(format="sog", block_size=LEAF)


def streamed(folder: Path, scene: Scene, config: Config = CONFIG) -> dict[str, Any]:
    """Write the files of a scene with small leaves; return its `lod-meta.json`."""
    files, _ = stream_levels(scene, config, FILE)
    write_files(folder, files)
    return json.loads(files[STREAMED])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return random_scene(1150, 2, seed=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scene) -> Path:
    """A scene with six leaves and three levels."""
    folder = tmp_path_factory.mktemp("streamed")
    streamed(folder, scene)
    return folder


@pytest.fixture
def copy(folder, tmp_path) -> Path:
    shutil.copytree(folder, tmp_path / "copy")
    return tmp_path / "copy"


def leaves_of(node: dict[str, Any]) -> list[dict[str, Any]]:
    """The leaves below a node; checks that its box encloses all boxes below it."""
    if "lods" in node:
        assert "children" not in node
        return [node]
    assert 1 <= len(node["children"]) <= 4
    for end, of in (("min", min), ("max", max)):
        ends = [child["bound"][end] for child in node["children"]]
        assert node["bound"][end] == list(map(of, zip(*ends, strict=True)))
    return [leaf for child in node["children"] for leaf in leaves_of(child)]


def counts_of(leaf: dict[str, Any]) -> list[int]:
    return [run["count"] for run in leaf["lods"].values()]


def test_the_tree_has_the_layout_viewers_expect(folder, scene):
    meta = json.loads((folder / STREAMED).read_text())
    assert (meta["version"], meta["asset"]) == (1, {"generator": "gs_codec"})
    leaves = leaves_of(meta["tree"])
    assert len(leaves) == 6
    assert meta["lodLevels"] == 3
    for level, count in enumerate(meta["counts"]):
        runs = [leaf["lods"][str(level)] for leaf in leaves]
        assert sum(run["count"] for run in runs) == count
        assert abs(count - scene.count / 4**level) <= 2 * len(leaves)
        assert all(run["count"] > 0 for run in runs)
    assert meta["counts"][0] == scene.count
    assert meta["count"] == sum(meta["counts"])
    assert all(list(leaf["lods"]) == ["0", "1", "2"] for leaf in leaves)


def test_each_gaussian_of_a_file_is_in_one_leaf_and_in_its_box(folder):
    meta = json.loads((folder / STREAMED).read_text())
    assert meta["filenames"] == [
        *(f"0_{k}/meta.json" for k in range(3)),
        "1_0/meta.json",
        "2_0/meta.json",
    ]
    units = [read_scene(folder / name) for name in meta["filenames"]]
    held = [np.zeros(unit.count, int) for unit in units]
    for leaf in leaves_of(meta["tree"]):
        low, high = (np.array(leaf["bound"][end])[:, None] for end in ("min", "max"))
        for level, run in leaf["lods"].items():
            assert meta["filenames"][run["file"]].startswith(f"{level}_")
            some = slice(run["offset"], run["offset"] + run["count"])
            held[run["file"]][some] += 1
            centres = units[run["file"]].positions[:, some]
            assert centres.shape[1] == run["count"]
            near = 1e-3 * (1 + np.abs(centres))
            assert ((centres >= low - near) & (centres <= high + near)).all()
    assert all((count == 1).all() for count in held)
    assert all(unit.count <= FILE for unit in units)
    assert all(unit.sh_degree == 2 for unit in units)


def test_the_finest_level_is_the_scene(folder, scene):
    back = read_scene(folder / STREAMED)
    assert back.count == scene.count
    ordered = scene.take(spatial_order(scene.positions))
    np.testing.assert_allclose(back.positions, ordered.positions, atol=0.02)
    assert np.abs(back.f_dc - ordered.f_dc).mean() < 0.1


def test_coarser_levels_have_the_colours_of_the_scene(folder, scene):
    """SH-DC weighted by visibility: opacity times area."""

    def mean(each: Scene) -> np.ndarray:
        weights = np.exp(2 * each.log_scale.astype(float).mean(axis=0)) / (
            1 + np.exp(-each.opacity[0])
        )
        return (each.f_dc * weights).sum(axis=1) / weights.sum()

    for name in ("1_0", "2_0"):
        assert np.abs(mean(read_scene(folder / name / "meta.json")) - mean(scene)).max() < 0.3


@pytest.mark.parametrize("count", [1, 2, LEAF])
def test_a_small_scene_is_one_leaf(count, tmp_path):
    meta = streamed(tmp_path, random_scene(count, 0))
    assert meta["counts"] == [count]
    assert meta["filenames"] == ["0_0/meta.json"]
    assert meta["tree"]["lods"] == {"0": {"file": 0, "offset": 0, "count": count}}


@pytest.mark.parametrize("count", [LEAF + 1, 5 * LEAF])
def test_leaves_are_of_equal_size(count, tmp_path):
    leaves = leaves_of(streamed(tmp_path, random_scene(count, 0))["tree"])
    sizes = [leaf["lods"]["0"]["count"] for leaf in leaves]
    assert max(sizes) - min(sizes) <= 1
    assert max(sizes) <= LEAF


@pytest.mark.parametrize("levels", [1, 2, 5])
def test_the_number_of_levels_can_be_chosen(levels, scene, tmp_path):
    meta = streamed(tmp_path, scene, replace(CONFIG, lod_levels=levels))
    assert meta["lodLevels"] == len(meta["counts"]) == levels
    for leaf in leaves_of(meta["tree"]):
        first, *coarser = counts_of(leaf)
        assert first in (191, 192)
        assert coarser == [48, 12, 3, 1][: levels - 1]
    assert read_scene(tmp_path / STREAMED).count == scene.count


def test_the_size_of_parts_can_be_typed(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(2100, 0))
    for folder, typed in (("typed", ("--block-size", "1024", "--lod-levels", "2")), ("plain", ())):
        target = tmp_path / folder / STREAMED
        target.parent.mkdir()
        words = ["convert", str(tmp_path / "scene.ply"), str(target), *typed]
        assert CliRunner().invoke(app, words).exit_code == 0
    typed, plain = (
        [counts_of(leaf) for leaf in leaves_of(json.loads(file.read_text())["tree"])]
        for file in (tmp_path / "typed" / STREAMED, tmp_path / "plain" / STREAMED)
    )
    assert typed == [[700, 175]] * 3
    assert plain == [[2100]]


def test_equal_gaussians_are_accepted(tmp_path):
    scene = random_scene(1, 1).take(np.zeros(900, np.int64))
    meta = streamed(tmp_path, scene)
    assert meta["counts"][0] == 900
    assert np.isfinite([*meta["tree"]["bound"]["min"], *meta["tree"]["bound"]["max"]]).all()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_do_not_matter(threads, scene, folder):
    files, _ = stream_levels(scene, replace(CONFIG, threads=threads), FILE)
    assert list(files)[-1] == STREAMED
    for name, data in files.items():
        assert (folder / name).read_bytes() == data, name


@pytest.mark.thorough
def test_the_antialias_flag_and_the_coordinates_of_sog_hold_for_all_levels(tmp_path, scene):
    given = replace(scene, comments=(ANTIALIASED, "by hand"))
    turned = turn_axes(state_system(given, CONVENTION), "RUB")
    files, lost = stream_levels(turned, CONFIG, FILE)
    write_files(tmp_path, files)
    for name in ("0_0", "1_0", "2_0"):
        assert json.loads(files[f"{name}/meta.json"])["model"] == "antialiased"
    assert read_scene(tmp_path / STREAMED).antialiased
    plain, _ = stream_levels(given, CONFIG, FILE)
    assert plain == files
    assert [line for line in lost if "comments" in line]


def test_flat_gaussians_are_told_once(tmp_path, scene, caplog):
    streamed(tmp_path, replace(scene, comments=(FLAT,)))
    read_scene(tmp_path / STREAMED)
    check_file(tmp_path / STREAMED)
    told = [line for line in caplog.messages if "2DGS" in line]
    assert told == [f"{tmp_path / STREAMED}: a 2DGS scene; its Gaussians are flat"]


def test_unknown_models_and_missing_rotations_are_told_once(copy, caplog):
    for path in copy.glob("*/meta.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"model": "soft"}))
        quats = path.with_name("quats.webp")
        with Image.open(quats) as image:
            pixels = np.array(image)
        pixels[0, 0, 3] = 251
        quats.write_bytes(foreign.webp(pixels))
    read_scene(copy / STREAMED)
    said = [line.removeprefix(f"{copy / STREAMED}: ") for line in caplog.messages]
    three = "3 rotations without a value, set to the identity"  # one a file of the finest level
    assert said == ["left out: unknown model 'soft'", three]


@pytest.mark.thorough
def test_profiles_choose_how_fine_all_levels_are(scene):
    sizes = [
        sum(map(len, stream_levels(scene, replace(CONFIG, profile=profile), FILE)[0].values()))
        for profile in "lms"
    ]
    assert sizes[0] > sizes[1] > sizes[2]


# Files


def test_a_conversion_counts_all_files_of_all_levels(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(300, 1))
    (tmp_path / "out").mkdir()
    done = convert_file(tmp_path / "scene.ply", tmp_path / "out" / STREAMED)
    files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert len(files) == 9
    assert done.file_bytes == sum(path.stat().st_size for path in files)
    assert done.count == 300


def test_other_commands_read_the_finest_level(folder, scene):
    with open_scene(folder / STREAMED) as file:
        assert file.format == "streamed sog"
        assert file.stated_bytes() == scene.float_bytes
    told = overview_of(folder / STREAMED)
    assert (told.format, told.count, told.sh_degree) == ("streamed sog", scene.count, 2)
    assert told.file_bytes == sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())


def test_an_environment_is_part_of_the_scene(copy, scene):
    shutil.copytree(copy / "2_0", copy / "env")
    meta = json.loads((copy / STREAMED).read_text())
    (copy / STREAMED).write_text(json.dumps(meta | {"environment": "env/meta.json"}))
    assert read_scene(copy / STREAMED).count == scene.count + meta["counts"][2]


def test_only_the_runs_of_the_finest_level_are_read(copy):
    """A file may have other Gaussians, too, such as those of coarser levels."""
    whole, meta = read_scene(copy / STREAMED), json.loads((copy / STREAMED).read_text())
    run = next(x["lods"]["0"] for x in leaves_of(meta["tree"]) if x["lods"]["0"]["file"] == 0)
    first = run["offset"]
    run |= {"offset": first + 3, "count": run["count"] - 3}
    (copy / STREAMED).write_text(json.dumps(meta))
    kept = np.delete(np.arange(whole.count), range(first, first + 3))
    assert_same_floats(read_scene(copy / STREAMED), whole.take(kept))


def test_incomplete_output_has_no_meta(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(300, 1))
    (tmp_path / "0_0").write_text("in the way")
    with pytest.raises(InvalidInput, match="0_0"):
        convert_file(tmp_path / "scene.ply", tmp_path / STREAMED)
    assert not (tmp_path / STREAMED).exists()


REFUSED: dict[str, tuple[Callable[[Path, Path], object], str]] = {
    "encode": (encode_file, "`convert` writes that"),
    "prepare": (
        lambda source, target: prepare_file(source, target, Plan(Steps(prune=9), width=16)),
        "`convert` writes that",
    ),
    "lod": (lambda source, target: convert_file(source, target, Config(lod=True)), "lod"),
    "profile": (
        lambda source, target: convert_file(source, target, Config("lossless")),
        "profile 'lossless'",
    ),
    "format": (
        lambda source, target: convert_file(source, target, Config(format="spz")),
        "format 'spz', expected",
    ),
    "levels of one Gaussian": (
        lambda source, target: convert_file(source, target, Config(format="sog", lod_levels=5)),
        "lod_levels 5: at most 4 for 1 part of 30 Gaussians",
    ),
    "levels of a scene without": (
        lambda source, target: convert_file(
            source, target.with_name("a.sog"), Config(format="sog", lod_levels=2)
        ),
        r"lod_levels: format 'sog', expected \.ssog or lod-meta\.json",
    ),
    "parts of a scene without": (
        lambda source, target: encode_file(
            source, target.with_name("a.sog"), Config(format="sog", block_size=2048)
        ),
        r"block_size: format 'sog', expected \.egs, \.ssog or lod-meta\.json",
    ),
    "name": (
        lambda source, target: convert_file(source, target.with_name(f"a-{STREAMED}")),
        "expected the name lod-meta.json",
    ),
    "existing": (
        lambda source, target: convert_file(
            source, source.parent / "there" / STREAMED, overwrite=False
        ),
        "exists",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_incompatible_options_are_refused(case, tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(30, 1))
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / STREAMED).write_text("{}")
    act, said = REFUSED[case]
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InvalidInput, match=said):
        act(tmp_path / "scene.ply", tmp_path / STREAMED)
    assert sorted(tmp_path.rglob("*")) == before


def test_no_gaussians_and_nan_are_refused():
    with pytest.raises(InvalidInput, match=r"no Gaussians, lod-meta\.json needs at least one"):
        stream_levels(random_scene(0, 1), CONFIG)
    scene = random_scene(30, 1)
    scene.positions[1, 7] = np.nan
    with pytest.raises(InvalidInput, match="not finite"):
        stream_levels(scene, CONFIG)
    files, _ = stream_levels(scene, replace(CONFIG, nonfinite="drop"))
    assert json.loads(files[STREAMED])["counts"] == [29]


# All files in one zip


def zipped(folder: Path, path: Path, inside: str = "", order: int = 1, slash: str = "/") -> Path:
    """A zip of the files of a folder, placed below `inside`."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())[::order]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            name = f"{inside}{file.relative_to(folder).as_posix()}"
            entry = zipfile.ZipInfo(name)
            entry.filename = entry.orig_filename = name.replace("/", slash)
            archive.writestr(entry, file.read_bytes())
    return path


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(
    ("inside", "slash"), [("", "/"), ("mouse/", "/"), ("./", "/"), ("a/b/", "\\")]
)
def test_a_zip_is_read_like_its_folder(inside, slash, order, folder, tmp_path):
    path = zipped(folder, tmp_path / "scene.zip", inside, order, slash)
    assert_same_floats(read_scene(path), read_scene(folder / STREAMED))
    told = overview_of(path)
    assert (told.format, told.count) == ("streamed sog", 1150)
    assert told.file_bytes == path.stat().st_size


def test_units_may_be_bundles(folder, tmp_path):
    """Each SOG scene of a level may be a zip, both in a folder and in a zip."""
    meta = json.loads((folder / STREAMED).read_text())
    units = tmp_path / "units"
    units.mkdir()
    for name in meta["filenames"]:
        unit = name.split("/")[0]
        zipped(folder / unit, units / f"{unit}.sog")
    names = [name.replace("/meta.json", ".sog") for name in meta["filenames"]]
    (units / STREAMED).write_text(json.dumps(meta | {"filenames": names}))
    expected = read_scene(folder / STREAMED)
    assert_same_floats(read_scene(units / STREAMED), expected)
    assert_same_floats(read_scene(zipped(units, tmp_path / "all.ssog")), expected)
    path = zipped(units, tmp_path / "all.zip")  # not a zip of frames
    assert not has_frames(path)
    assert_same_floats(read_scene(path), expected)
    stored = overview_of(units / STREAMED).file_bytes
    assert stored == sum(path.stat().st_size for path in units.iterdir())


def test_names_of_files_may_have_backslashes(copy, scene):
    meta = json.loads((copy / STREAMED).read_text())
    names = [name.replace("/", "\\") for name in meta["filenames"]]
    (copy / STREAMED).write_text(json.dumps(meta | {"filenames": names}))
    assert read_scene(copy / STREAMED).count == scene.count


def test_ssog_is_a_zip_of_the_same_files(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(300, 1))
    done = convert_file(tmp_path / "scene.ply", tmp_path / "scene.ssog")
    (tmp_path / "apart").mkdir()
    convert_file(tmp_path / "scene.ply", tmp_path / "apart" / STREAMED)
    with zipfile.ZipFile(tmp_path / "scene.ssog") as archive:
        names = archive.namelist()
        assert names[0] == STREAMED
        for name in names:
            assert archive.read(name) == (tmp_path / "apart" / name).read_bytes()
    assert len(names) == sum(file.is_file() for file in (tmp_path / "apart").rglob("*"))
    assert done.file_bytes == (tmp_path / "scene.ssog").stat().st_size


LATER = ("0_1", "0_2", "1_0", "2_0")


def of_one_file(folder: Path) -> None:
    """Keep only the first SOG scene of a streamed SOG folder."""
    for part in LATER:
        shutil.rmtree(folder / part)
    (folder / STREAMED).unlink()


SEVERAL: dict[str, Callable[[Path], object]] = {
    "'a/lod-meta.json', 'b/lod-meta.json'": lambda root: None,
    "'a/lod-meta.json', 'b/0_0/meta.json'": lambda root: of_one_file(root / "b"),
    "'a/0_0/meta.json', 'b/0_0/meta.json'": lambda root: [of_one_file(root / x) for x in "ab"],
    "'a/lod-meta.json', 'a/meta.json'": lambda root: (
        shutil.rmtree(root / "b"),
        shutil.copy(root / "a" / "0_0" / "meta.json", root / "a"),
    ),
    "'a/b/lod-meta.json', 'a/lod-meta.json'": lambda root: (root / "b").rename(root / "a" / "b"),
}


@pytest.mark.parametrize("names", SEVERAL)
def test_a_zip_of_several_scenes_is_refused_with_their_names(names, folder, tmp_path):
    for each in "ab":
        shutil.copytree(folder, tmp_path / "root" / each)
    SEVERAL[names](tmp_path / "root")
    path = zipped(tmp_path / "root", tmp_path / "two.zip")
    with pytest.raises(InvalidInput, match=re.escape(f"a zip of 2 scenes ({names}), expected one")):
        read_scene(path)


def test_units_that_share_images_are_refused(copy):
    """Each unit is read separately: thousands that share images would take minutes."""
    shutil.copy(copy / "0_1" / "meta.json", copy / "0_1" / "again.json")
    meta = json.loads((copy / STREAMED).read_text())
    meta["filenames"][2] = "0_1/again.json"
    (copy / STREAMED).write_text(json.dumps(meta))
    with pytest.raises(
        InvalidInput, match=r"again.json: image 'means_l.webp' also belongs to another"
    ):
        read_scene(copy / STREAMED)


@pytest.mark.parametrize("parts", [1, 70])
def test_images_of_many_parts_are_hardly_larger_than_the_parts(parts, tmp_path):
    """A single-colour image takes a hundred bytes, whatever its size."""
    meta, images = foreign.sog_parts(8, 2, 0, seed=1)
    names = [f"{number}/meta.json" for number in range(parts)]
    runs = [{"lods": {"0": {"file": number, "offset": 0, "count": 8}}} for number in range(parts)]
    described = {"version": 1, "filenames": names, "tree": {"children": runs}}
    files = {name: foreign.webp(pixels) for name, pixels in images.items()}
    files["meta.json"] = json.dumps(meta).encode()
    with zipfile.ZipFile(tmp_path / "scene.ssog", "w") as archive:
        archive.writestr(STREAMED, json.dumps(described))
        for number in range(parts):
            last = number == parts - 1
            wide = {"sh0.webp": foreign.webp(np.zeros((256, 256, 4), np.uint8))} if last else {}
            for name, data in (files | wide).items():
                archive.writestr(f"{number}/{name}", data)
    if parts == 1:
        assert read_scene(tmp_path / "scene.ssog").count == 8
    else:
        told = "69/meta.json: image 'sh0.webp': 256x256 pixels, expected at most 59934"
        with pytest.raises(InvalidInput, match=told):
            read_scene(tmp_path / "scene.ssog")


def test_a_zip_in_a_zip_in_a_zip_is_not_unpacked(copy, tmp_path):
    meta = json.loads((copy / STREAMED).read_text())
    inner = zipped(copy / "0_0", tmp_path / "unit.zip").read_bytes()
    (copy / "0_0" / "meta.json").write_bytes(inner)
    with pytest.raises(InvalidInput, match=r"0_0/meta\.json: meta\.json: "):
        read_scene(zipped(copy, tmp_path / "a.ssog"))
    zipped(copy / "0_0", copy / "0_0.sog")
    meta["filenames"][0] = "0_0.sog"
    (copy / STREAMED).write_text(json.dumps(meta))
    with pytest.raises(InvalidInput, match=r"0_0\.sog: meta\.json: "):
        read_scene(zipped(copy, tmp_path / "b.ssog"))


def test_a_zip_that_unpacks_to_too_much_is_refused(copy, tmp_path):
    """Entries of 1 GiB of spaces and more, in 1 MB."""
    path = zipped(copy, tmp_path / "a.ssog")
    data = bytearray(path.read_bytes())
    # The unpacked size of a file, in the central directory.
    struct.pack_into("<I", data, data.rindex(b"PK\1\2") + 24, (1 << 30) + 1)
    path.write_bytes(data)
    with pytest.raises(
        InvalidInput, match=r"zip of 1[\d,]+ bytes unpacked, expected at most 1,073,741,824"
    ):
        read_scene(path)


def test_verify_reads_all_levels(copy, tmp_path):
    path = zipped(copy, tmp_path / "a.ssog")
    check_file(copy / STREAMED)
    check_file(path)
    (copy / "2_0" / "sh0.webp").write_bytes(b"RIFF")
    for damaged in (copy / STREAMED, zipped(copy, path)):
        assert read_scene(damaged).count == 1150
        with pytest.raises(InvalidInput, match=r"2_0/meta\.json: image 'sh0\.webp'"):
            check_file(damaged)


def test_a_zip_without_a_file_that_its_scene_needs_is_refused(copy, tmp_path):
    (copy / "0_1" / "meta.json").unlink()
    path = zipped(copy, tmp_path / "a.ssog")
    with pytest.raises(InvalidInput, match=r"0_1/meta.json: zip entry '0_1/meta.json': missing"):
        read_scene(path)


# Invalid files


def changed(**members: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda meta: meta | members


def with_file(name: str) -> Callable[[dict[str, Any]], Any]:
    """Replace the name of the first file."""
    return lambda meta: meta | {"filenames": [name, *meta["filenames"][1:]]}


DAMAGED: dict[str, Callable[[dict[str, Any]], Any]] = {
    "list": lambda meta: [meta],
    "version": changed(version=2),
    "no tree": changed(tree=None),
    "no leaves": changed(tree={"children": []}),
    "no files": changed(filenames=[]),
    "files of numbers": changed(filenames=[1, 2, 3, 4, 5]),
    "child": changed(tree={"children": [7]}),
    "file": changed(tree={"lods": {"0": {"file": 9}}}),
    "file of 10^400": changed(tree={"lods": {"0": {"file": 10**400}}}),
    "run beyond": changed(tree={"lods": {"0": {"file": 0, "offset": 0, "count": 451}}}),
    "run backwards": changed(tree={"lods": {"0": {"file": 0, "offset": 9, "count": -9}}}),
    "run of text": changed(tree={"lods": {"0": {"file": 0, "offset": "0", "count": "9"}}}),
    "kind of file": changed(tree={"lods": {"0": {"file": "0"}}}),
    "missing": with_file("0_0/none.json"),
    "a folder": with_file("0_0"),
    "above": with_file("../copy/0_0/meta.json"),
    "root": with_file("/etc/passwd"),
    "another host": with_file("https://host/meta.json"),
    "the same twice": with_file("0_1/meta.json"),
    "itself": with_file(STREAMED),
    "environment": changed(environment=["env"]),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_meta_is_refused(case, copy):
    path = copy / STREAMED
    path.write_text(json.dumps(DAMAGED[case](json.loads(path.read_text()))))
    with pytest.raises(GsCodecError, match=r"copy"):
        read_scene(path)


@pytest.mark.parametrize("text", ["{", "{}", '{"tree":' + '{"children":[' * 50_000])
def test_other_json_is_refused(text, tmp_path):
    (tmp_path / STREAMED).write_text(text)
    with pytest.raises(InvalidInput, match=r"lod-meta\.json"):
        read_scene(tmp_path / STREAMED)


def test_more_floats_than_allowed_are_refused(folder, scene):
    with pytest.raises(InvalidInput, match="max-bytes"):
        read_scene(folder / STREAMED, max_bytes=scene.float_bytes - 1)
    assert read_scene(folder / STREAMED, max_bytes=scene.float_bytes).count == scene.count


# Other programs


def test_splat_transform_reads_the_finest_level(folder):
    program = PROGRAMS["splat-transform"]
    try:
        [theirs] = program.read([folder / STREAMED])
    except MissingTool as error:
        pytest.skip(f"splat-transform: not installed ('make peers'), {error}")
    check(theirs, stored_numbers(folder / STREAMED), "sog", program.exact)


#: The box and the number of Gaussians by level of each leaf, and the number drawn.
SEEN = """[
    resource.octree.nodes.map((node) => [
        ...['getMin', 'getMax'].flatMap((end) => Object.values(node.bounds[end]())),
        ...node.lods.map((lod) => lod.count),
    ]),
    app.stats.frame.gsplats,
]"""


@pytest.mark.thorough
@in_browser
def test_playcanvas_draws_each_leaf_once_at_the_level_that_it_chooses(tmp_path):
    scene = generate(6000, 1, 12)
    files, _ = stream_levels(scene, replace(CONFIG, block_size=500), 3000)
    write_files(tmp_path, files)
    camera = auto_cameras(scene, 1)[0].resized(*SIZE)
    write_cameras(tmp_path / "cameras.json", [camera])
    asked = {"mixed": "splatBudget=2500", "coarse": "lodRangeMin=1&lodRangeMax=1"}
    with serving(tmp_path) as url:
        page = f"{url}project/tests/web/playcanvas.html?file={STREAMED}"
        jobs = [Job(f"{page}&{more}", []) for more in asked.values()]
        for name, job in zip(asked, jobs, strict=True):
            job.shot(str(tmp_path / f"{name}.png"))
            job.steps.append(("value", SEEN))
        mixed, coarse = open_pages(*jobs)
    levels = [
        {request.split("/")[-2][0] for request in told.requests if "means_l" in request}
        for told in (mixed, coarse)
    ]
    assert levels == [{"0", "1"}, {"1"}]
    leaves = leaves_of(json.loads(files[STREAMED])["tree"])
    expected = [[*leaf["bound"]["min"], *leaf["bound"]["max"], *counts_of(leaf)] for leaf in leaves]
    for told in (mixed, coarse):
        np.testing.assert_allclose(told.values[-1][0], expected, rtol=1e-5, atol=1e-5)
    # Of twelve leaves, two with 500 Gaussians and ten with 125; then twelve with 125.
    assert [told.values[-1][1] for told in (mixed, coarse)] == [2250, 1500]
    ours, level = drawn(scene, camera), read_scene(tmp_path / "1_0" / "meta.json")
    assert np.ptp(ours) > 0.3
    assert decibels(seen(tmp_path / "mixed.png"), ours) > 30
    assert decibels(seen(tmp_path / "coarse.png"), ours) > 28
    assert decibels(seen(tmp_path / "coarse.png"), drawn(level, camera)) > 32
