"""A scene encoded in tasks gives the same file as in one go, whatever the tasks and failures."""

from __future__ import annotations

import os
import random
import shutil
import sys
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from in_tasks import Here, Lost, in_tasks, saved, whole
from scenes import antialiased, edge_scenes, random_scene, thorough

from gs_codec import decode_distributed, encode_distributed
from gs_codec.codecs.part import Part
from gs_codec.config import Config
from gs_codec.distributed import survey as looking
from gs_codec.distributed.decoding import decode_with
from gs_codec.distributed.encoding import encode_in_tasks
from gs_codec.distributed.folder import Folder, work_folder
from gs_codec.distributed.sorting import find_cuts
from gs_codec.distributed.sources import open_sources
from gs_codec.distributed.tasks import Crew, size_within
from gs_codec.encoding import loss as check
from gs_codec.encoding import retry as checked
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import inspect_file
from gs_codec.guidance import calibrate, windows
from gs_codec.guidance.calibrate import wanted_error
from gs_codec.scene import Scene
from gs_codec.workers.pool import Pool
from samples.generate import generate

BLOCK = 1024


@pytest.fixture(scope="module")
def still_life() -> Scene:
    """A scene that is visible in crops."""
    return generate(6000, 1, 1)


@pytest.mark.one_in(8)
@pytest.mark.parametrize("size", [700, 3000, 10**6])
@pytest.mark.parametrize(("count", "degree"), [(1, 3), (1024, 0), (1025, 1), (7000, 3), (9000, 2)])
def test_tasks_of_any_size_give_the_same_file(tmp_path, count, degree, size):
    path = saved(tmp_path / "a.ply", random_scene(count, degree, seed=3))
    config = Config("m", block_size=BLOCK)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert in_tasks([path], tmp_path / "tasks.egs", config, size) == expected


def test_dropped_and_fused_properties_are_the_same_and_reported_once(tmp_path, caplog):
    columns = {name: np.linspace(0, 1, 5000, dtype="<f4") for name in ("nx", "ny", "nz", "label")}
    columns["filter_3D"] = columns["label"]
    path = saved(tmp_path / "a.ply", replace(random_scene(5000, 1, seed=3), extra=columns))
    config = Config("m", block_size=BLOCK)
    expected, said = whole(path, tmp_path / "whole.egs", config), caplog.messages[:]
    caplog.clear()
    assert in_tasks([path], tmp_path / "tasks.egs", config, 700) == expected
    assert caplog.messages == said
    assert said[1:] == [f"{path}: left out: properties nx, ny, nz, label"]


@pytest.mark.one_in(6)
@pytest.mark.parametrize("name", sorted(edge_scenes()))
def test_scenes_at_the_limits(tmp_path, name):
    scene = edge_scenes()[name]
    path = saved(tmp_path / "a.ply", replace(scene, has_normals=True, comments=("a b", "c")))
    config = Config("s", block_size=BLOCK)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert in_tasks([path], tmp_path / "tasks.egs", config, 100) == expected


@pytest.mark.parametrize("size", [thorough(100), 5000, thorough(10**6)])
@pytest.mark.parametrize("blended", [False, thorough(True)])
def test_levels_are_the_same(tmp_path, blended, size):
    scene = antialiased(replace(random_scene(18_000, 1, seed=11), has_normals=True), blended)
    path = saved(tmp_path / "a.ply", scene)
    config = Config("m", block_size=BLOCK, lod=True, coarseness=1.5)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert inspect_file(tmp_path / "whole.egs").levels
    assert in_tasks([path], tmp_path / "tasks.egs", config, size) == expected


@pytest.mark.thorough
@pytest.mark.parametrize("bad", [0.0, 0.1])
def test_values_are_cleaned_in_every_task(tmp_path, still_life, bad):
    rng = np.random.default_rng(1)
    scene = replace(still_life, f_rest=still_life.f_rest.copy(), rot=still_life.rot.copy())
    scene.f_rest[3, rng.random(6000) < bad] = np.nan
    scene.rot[:, ::7] = 0
    path = saved(tmp_path / "a.ply", scene)
    config = Config("m", block_size=BLOCK, nonfinite="drop")
    expected = whole(path, tmp_path / "whole.egs", config)
    assert expected[1]["rendered"] is not None
    assert in_tasks([path], tmp_path / "tasks.egs", config, 999) == expected
    if bad:
        with pytest.raises(InvalidInput, match=r"a\.ply: values that are not finite: .* in f_rest"):
            in_tasks([path], tmp_path / "b.egs", replace(config, nonfinite="error"), 999)


def test_an_empty_result_is_an_error_in_tasks_too(tmp_path):
    scene = random_scene(300, 1, seed=2)
    path = saved(tmp_path / "a.ply", replace(scene, f_rest=np.full_like(scene.f_rest, np.nan)))
    config = Config("m", block_size=BLOCK, nonfinite="drop")
    said = []
    for encode in (
        lambda out: whole(path, out, config),
        lambda out: in_tasks([path], out, config, 99),
    ):
        with pytest.raises(
            InvalidInput, match="no Gaussian is left of 300: all contain NaN"
        ) as error:
            encode(tmp_path / "out.egs")
        said.append(str(error.value))
    assert said[0] == said[1]
    assert not (tmp_path / "out.egs").exists()


@pytest.fixture
def aiming(monkeypatch):
    """Make encoders target a share of the error."""

    def aim(share: float, helps: float = 0.8) -> None:
        monkeypatch.setattr(checked, "wanted_error", lambda config: share * wanted_error(config))
        monkeypatch.setattr(checked, "_HELPS", helps)

    return aim


@pytest.mark.parametrize("size", [900, thorough(10**6)])
@pytest.mark.parametrize(
    ("share", "helps", "lod", "encodings"),
    [(0.05, 0.8, False, 2), thorough(0.05, 0.8, True, 2), (0.05, 0.0, False, 1)],
)
def test_finer_steps_are_the_same(tmp_path, still_life, aiming, size, share, helps, lod, encodings):
    aiming(share, helps)
    path = saved(tmp_path / "a.ply", still_life)
    config = Config("s", block_size=BLOCK, lod=lod)
    expected = whole(path, tmp_path / "whole.egs", config)
    loss = expected[1]["rendered"]
    assert (loss["encodings"], loss["remedy"] is None) == (encodings, encodings == 1)
    here = Here()
    assert in_tasks([path], tmp_path / "tasks.egs", config, size, here) == expected
    coded = [task for task in here.done if "code-" in task and "level" not in task]
    assert len(coded) == (2 if size == 900 else 1)  # once, by chunks of four blocks
    assert len(here.done) == len(set(here.done))


def test_strict_refuses_the_same(tmp_path, still_life, aiming):
    aiming(0.05, 0.0)
    path = saved(tmp_path / "a.ply", still_life)
    config = Config("s", block_size=BLOCK, strict=True)
    with pytest.raises(InvalidInput, match="rendered views lose") as expected:
        encode_file(path, tmp_path / "whole.egs", config)
    with pytest.raises(InvalidInput) as found:
        in_tasks([path], tmp_path / "tasks.egs", config, 900)
    assert str(expected.value).endswith(str(found.value))


def test_windows_with_too_many_gaussians_are_skipped_in_all_tasks(
    tmp_path, still_life, monkeypatch
):
    path = saved(tmp_path / "a.ply", still_life)
    config = Config("m", block_size=BLOCK)
    before = whole(path, tmp_path / "whole.egs", config)
    for module in (calibrate, check, windows, looking):
        monkeypatch.setattr(module, "MOST_SHOWN", 700)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert expected[1]["rendered"]["windows"] < before[1]["rendered"]["windows"]
    assert in_tasks([path], tmp_path / "tasks.egs", config, 900) == expected


def test_tiles_are_one_scene(tmp_path):
    first, second, third = (random_scene(n, d, seed=n) for n, d in ((3000, 1), (1, 0), (4000, 3)))
    paths = [
        saved(tmp_path / "a.ply", replace(first, comments=("of a",))),
        saved(tmp_path / "b.ply", replace(second, comments=("gs_codec coordinates RUB",))),
    ]
    encode_file(saved(tmp_path / "c.ply", third), tmp_path / "c.egs", Config("l", block_size=BLOCK))
    paths.append(tmp_path / "c.egs")
    config = Config("m", block_size=BLOCK)
    done = convert_file(paths, tmp_path / "whole.egs", config)
    data, report = in_tasks(paths, tmp_path / "tasks.egs", config, 1500)
    assert report["rendered"] == asdict(done.rendered)
    assert data == (tmp_path / "whole.egs").read_bytes()
    assert (report["count"], report["input_bytes"]) == (7001, sum(map(os.path.getsize, paths)))


@pytest.mark.parametrize("seed", range(8))
def test_cuts_are_where_the_sorted_whole_has_them(tmp_path, seed):
    rng = np.random.default_rng(seed)
    folder, bits = Folder(tmp_path), int(rng.integers(1, 63))
    few = int(rng.integers(1, min(2**bits, 50) + 1))
    values = rng.integers(0, 2**bits, few)
    runs = [np.sort(rng.choice(values, rng.integers(0, 40))) for _ in range(5)]
    for number, codes in enumerate(runs):
        folder.save_mapped(f"codes-{number}", codes)
    every = np.concatenate(runs)
    of_run = np.repeat(np.arange(5), [len(codes) for codes in runs])
    order = np.argsort(every, kind="stable")
    ranks = [*range(0, len(every), 7), len(every)]
    cuts = find_cuts(folder, 5, ranks, bits)
    expected = [np.bincount(of_run[order[:rank]], minlength=5) for rank in ranks]
    assert np.array_equal(cuts, np.stack(expected, axis=1))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("degree", [None, 1])
@pytest.mark.parametrize("box", [None, (-1.0, -1.0, -1.0, 0.5, 0.5, 0.5)])
@pytest.mark.parametrize("profile", ["m", "lossless"])
def test_decoding_in_tasks_gives_the_same_file(tmp_path, profile, box, degree):
    scene = replace(random_scene(9000, 3, seed=5), has_normals=True, comments=("x",))
    path = saved(tmp_path / "a.ply", scene)
    encode_file(path, tmp_path / "a.egs", Config(profile, block_size=BLOCK))
    part = Part(box, degree)
    expected = decode_file(tmp_path / "a.egs", tmp_path / "whole.ply", part)
    found = decode_with(Crew(Here()), tmp_path / "a.egs", tmp_path / "tasks.ply", part, 2048)
    assert (tmp_path / "tasks.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert replace(found, seconds={}) == replace(expected, seconds={})
    assert not (tmp_path / "tasks.ply.parts").exists()


def test_empty_box_is_refused_and_nothing_is_left(tmp_path):
    encode_file(saved(tmp_path / "a.ply", random_scene(10)), tmp_path / "a.egs")
    kept = sorted(tmp_path.iterdir())
    with pytest.raises(InvalidInput, match="no Gaussians in the box, bounds"):
        decode_with(
            Crew(Here()), tmp_path / "a.egs", tmp_path / "b.ply", Part((9, 9, 9, 10, 10, 10)), 99
        )
    assert sorted(tmp_path.iterdir()) == kept


def test_damaged_file_is_refused_by_a_task(tmp_path):
    encode_file(
        saved(tmp_path / "a.ply", random_scene(5000)), tmp_path / "a.egs", Config(block_size=BLOCK)
    )
    data = bytearray((tmp_path / "a.egs").read_bytes())
    data[-100] ^= 1
    (tmp_path / "a.egs").write_bytes(data)
    with pytest.raises(CorruptStream, match="checksum does not match"):
        decode_with(Crew(Here()), tmp_path / "a.egs", tmp_path / "b.ply", Part(), BLOCK)
    assert not (tmp_path / "b.ply").exists()


@pytest.mark.thorough
@pytest.mark.rounds(3)
@pytest.mark.parametrize("share", [1.0, 0.05])
def test_an_interrupted_run_is_resumed(tmp_path, still_life, aiming, share, seed):
    aiming(share)
    path = saved(tmp_path / "a.ply", still_life)
    config, target = Config("m", block_size=BLOCK), tmp_path / "tasks.egs"
    expected = whole(path, tmp_path / "whole.egs", config)
    rng, done = random.Random(seed), list[str]()
    found = None
    while found is None:
        here = Here(rng.randrange(99), rng.randrange(1, 12))
        with suppress(Lost):
            found = in_tasks([path], target, config, 1500, here)
        assert target.exists() == (found is not None)
        done += here.done
    assert found == expected
    assert len(done) == len(set(done))


def test_results_of_other_runs_are_ignored(tmp_path):
    path, target = saved(tmp_path / "a.ply", random_scene(3000, 0)), tmp_path / "tasks.egs"
    with pytest.raises(Lost):
        in_tasks([path], target, Config("l"), 1000, Here(fails_at=8))
    saved(path, random_scene(3000, 0, seed=9))
    expected = whole(path, tmp_path / "whole.egs", Config("m"))
    assert in_tasks([path], target, Config("m"), 1000) == expected


def test_unrelated_files_in_the_folder_are_kept(tmp_path):
    path, target = saved(tmp_path / "a.ply", random_scene(3000, 0)), tmp_path / "a.egs"
    (tmp_path / "a.egs.parts/mine").mkdir(parents=True)
    (tmp_path / "a.egs.parts/mine/notes").touch()
    with pytest.raises(Lost):
        in_tasks([path], target, Config("l"), 1000, Here(fails_at=3))
    encode_in_tasks(Crew(Here()), open_sources([path], "error"), target, Config("m"), 1000)
    found = sorted((tmp_path / "a.egs.parts").rglob("*"))
    assert [entry.name for entry in found] == ["mine", "notes"]


def test_two_runs_cannot_share_a_folder(tmp_path):
    where = tmp_path / "a.egs"
    other = pytest.raises(InvalidInput, match=r"a\.egs\.parts: another run is using it")
    with work_folder(where, {}), other, work_folder(where, {}):
        pass
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_shared_is_named(tmp_path):
    folder = Folder(tmp_path)
    for find in (lambda: folder.load("scan-3"), lambda: folder.mapped("codes-3")):
        with pytest.raises(InvalidInput, match=r"no result '(scan|codes)-3' .* workers share"):
            find()
    (tmp_path / "scan-3.npz").write_bytes(b"no zip")
    with pytest.raises(InvalidInput, match="no result 'scan-3'"):
        folder.load("scan-3")


def test_memory_of_a_worker_limits_the_size_of_a_task():
    assert size_within(None, 4, 3, 10**6) == size_within(10**12, 1, 3, 10)
    one, four = (size_within(10**9, at_once, 3, 1024) for at_once in (2, 8))
    assert one == pytest.approx(4 * four, rel=0.01)
    with pytest.raises(InvalidInput, match="max-memory: 300,000,000 bytes, expected at least"):
        size_within(300_000_000, 1, 3, 1024)


@pytest.mark.parametrize(
    ("config", "match"),
    [
        (Config("paper-m"), "profile 'paper-m', expected l, m, s"),
        (Config("lossless"), "profile 'lossless', expected l, m, s"),
        (Config("m", format="spz"), "expected l, m, s of an .egs"),
        (Config("m", depths={"opacity": 8}), "cannot be combined with depths"),
        (Config("m", extra="keep"), "extra properties are not kept"),
    ],
)
def test_options_that_need_the_whole_scene_are_refused(tmp_path, config, match):
    path = saved(tmp_path / "a.ply", random_scene(10))
    with pytest.raises(InvalidInput, match=match):
        encode_distributed(path, tmp_path / "a.egs", config)


def test_levels_are_decoded_by_one_process(tmp_path):
    with pytest.raises(InvalidInput, match="dask: cannot be combined with a level or a view"):
        decode_distributed(tmp_path / "a.egs", tmp_path / "b.ply", Part(level=1))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["encode", "-", "b.egs"], "-: a pipe, expected a file with --dask"),
        (["encode", "scene.ply", "-"], "-: a pipe, expected a file with --dask"),
        (["encode", "none", "b.egs"], "none: no such file, or no .ply or .egs in this folder"),
        (
            ["encode", "cameras.json", "b.egs"],
            "cameras.json: only .egs and binary PLY of floats are read in parts",
        ),
        (
            ["encode", "scene.ply", "b.egs", "--cameras", "auto"],
            "--dask: cannot be combined",
        ),
        (
            ["encode", "scene.ply", "b.egs", "--target-size", "9kB"],
            "--dask: cannot be combined",
        ),
        (["encode", "scene.ply", "b.egs", "--scale", "2"], "--dask: cannot be combined"),
        (["encode", "scene.ply", "b.egs", "--max-bytes", "9"], "--max-bytes has no effect"),
        (["encode", "scene.ply", "scene.egs"], "scene.egs: already exists"),
        (["decode", "scene.egs", "-"], "-: a pipe, expected a file with --dask"),
        (["decode", "scene.egs", "b.ply", "--max-bytes", "9"], "--max-bytes has no effect"),
        (["decode", "scene.egs", "decoded.ply"], "decoded.ply: already exists"),
        (["decode", "scene.egs", "b.ply", "--level", "1"], "--level has no effect with --dask"),
        (["decode", "scene.egs", "b.ply", "--view", "none"], "--view has no effect with --dask"),
    ],
)
def test_command_refuses_options_without_effect(folder, arguments, expected):
    status, out, err = folder.run(*arguments, "--dask", "local")
    assert (status, out) == (2, "")
    assert expected in err


def test_missing_dask_is_named(folder):
    folder.monkeypatch.delitem(sys.modules, "gs_codec.workers.dask", raising=False)
    for name in ("dask", "distributed"):
        folder.monkeypatch.setitem(sys.modules, name, None)
    status, _, err = folder.run("encode", "scene.ply", "b.egs", "--dask", "local")
    assert status == 2
    assert err == "gs-codec: error: dask: needs distributed; pip install 'gs-codec[cluster]'\n"


def test_one_process_needs_no_dask(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "gs_codec.workers.dask", raising=False)
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    path = saved(tmp_path / "a.ply", random_scene(3000, 0, seed=3))
    expected, _ = whole(path, tmp_path / "whole.egs", Config("m", block_size=BLOCK))
    target, back = tmp_path / "tasks.egs", [tmp_path / "whole.ply", tmp_path / "tasks.ply"]
    config, heard = Config("m", block_size=BLOCK), set()
    encode_distributed(
        path, target, config, dask=None, max_memory=400_000_000,
        progress=lambda stage, *_: heard.add(stage),
    )  # fmt: skip
    assert target.read_bytes() == expected
    assert {"scan", "sort", "quantise", "code"} <= heard
    decode_file(target, back[0])
    decode_distributed(target, back[1], dask=None, max_memory=400_000_000)
    assert back[1].read_bytes() == back[0].read_bytes()
    with pytest.raises(InvalidInput, match="profile 'lossless', expected l, m, s"):
        encode_distributed(path, tmp_path / "exact.egs", "lossless", dask=None)


def test_a_pool_of_processes_gives_the_same_file(tmp_path):
    path = saved(tmp_path / "a.ply", random_scene(3000, 0, seed=3))
    config = Config("m", block_size=BLOCK)
    with Pool(1, None, str(tmp_path)) as workers:
        found = in_tasks([path], tmp_path / "tasks.egs", config, 2000, workers)
    assert found == whole(path, tmp_path / "whole.egs", config)


@pytest.mark.thorough
def test_workers_of_a_cluster_give_the_same_files(folder):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    folder.run("encode", "scene.ply", "whole.egs")
    assert folder.run("encode", "scene.ply", "tasks.egs", "--dask", "local")[0] == 0
    assert Path("tasks.egs").read_bytes() == Path("whole.egs").read_bytes()
    folder.run("decode", "whole.egs", "whole.ply")
    assert folder.run("decode", "whole.egs", "tasks.ply", "--dask", "local")[0] == 0
    assert Path("tasks.ply").read_bytes() == Path("whole.ply").read_bytes()
    Path("tiles/more").mkdir(parents=True)
    shutil.copy("scene.ply", "tiles/a.ply")
    shutil.copy("whole.egs", "tiles/more/b.egs")
    status, _, err = folder.run("encode", "tiles", "both.egs", "--dask", "local")
    assert (status, "tiles: merging 2 files (.ply and .egs)" in err) == (0, True)
    data = bytearray(Path("whole.egs").read_bytes())
    data[-50] ^= 1
    Path("whole.egs").write_bytes(data)
    status, _, err = folder.run("decode", "whole.egs", "b.ply", "--dask", "local")
    assert status == 2
    assert "checksum does not match" in err
