"""Sequences: what frames cost, what they decode to, and what commands do with them."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import Folder
from moving_scenes import coded, given, moving
from scenes import SmallBlocks, assert_same_floats, random_scene

from gs_codec.cameras.inria import as_camera
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.adaptive.moving_block import MovingBlock
from gs_codec.codecs.adaptive.moving_block_encoder import BlockEncoder, turns_between
from gs_codec.codecs.encode import encode_parts
from gs_codec.codecs.pairing import Pairing
from gs_codec.coding.axes import reordered, rotation_matrix, sort_axes
from gs_codec.coding.morton import spatial_order
from gs_codec.coding.neighbours import Neighbours
from gs_codec.config import Config, RateTarget
from gs_codec.egs.frame_sections import is_sequence
from gs_codec.encoding.loss import Check
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.writer import write_ply
from gs_codec.plan import Plan
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene
from gs_codec.sequences import frame_encoding, frame_targets
from gs_codec.sequences.frame_decoding import opened_sequence
from gs_codec.sequences.frame_encoding import encode_frames
from gs_codec.sequences.frame_sources import open_frames
from gs_codec.sequences.frame_targets import encode_requested
from samples.generate import orbit_cameras

SMALL = SmallBlocks("m", block_size=600, threads=1)


def decoded(path, *span) -> list[Scene]:
    with opened_sequence(path) as sequence:
        return list(sequence.frames(*span))


def test_what_does_not_move_costs_nothing(tmp_path):
    scene = random_scene(1200)
    report = coded(tmp_path / "a.egs", 4 * [scene])
    assert (report.frames, report.key_frames, report.fps) == (4, 1, 25.0)
    # A size and a few decisions for each of 2 blocks.
    assert report.file_bytes - report.key_bytes < 400 + 3 * 40
    alone = decode_scene(encode_scene(scene, SmallBlocks("m", block_size=600))[0])
    for frame in decoded(tmp_path / "a.egs"):
        assert_same_floats(frame, alone)


def worst(scene: Scene, other: Scene, group: str) -> float:
    return float(np.abs(getattr(scene, group) - getattr(other, group)).max())


@pytest.mark.parametrize("degree", [0, 3])
def test_frames_are_as_close_as_scenes_of_their_own(tmp_path, degree):
    scenes = moving(sh_degree=degree, frames=6)
    report = coded(tmp_path / "a.egs", scenes)
    assert report.key_frames == 1
    for scene, frame in zip(scenes, decoded(tmp_path / "a.egs"), strict=True):
        data, _ = encode_scene(scene, SmallBlocks("m", block_size=600))
        alone = decode_scene(data)
        assert frame.count == scene.count
        for group in ("positions", "opacity", "f_dc", "f_rest"):
            errors = [
                np.sort(getattr(found, group), axis=1) - np.sort(getattr(scene, group), axis=1)
                for found in (frame, alone)
            ]
            if errors[0].size:
                assert np.sqrt(np.mean(errors[0] ** 2)) < 1.5 * np.sqrt(np.mean(errors[1] ** 2))


def test_encoder_knows_what_is_decoded(tmp_path, monkeypatch):
    scenes, coded_frames, filled = moving(), [], []
    encode = BlockEncoder.encode

    def encoding(self, *given):
        data, frame = encode(self, *given)
        coded_frames.append(frame)
        return data, frame

    monkeypatch.setattr(BlockEncoder, "encode", encoding)
    encode_frames(given(scenes), tmp_path / "a.egs", Request(SMALL))
    monkeypatch.setattr(
        MovingBlock,
        "fill",
        lambda self, frame, planes: (filled.append(frame), setattr(self, "frame", frame)),
    )
    with opened_sequence(tmp_path / "a.egs") as sequence, using_threads(1):
        list(sequence.frames())
    assert len(filled) == len(coded_frames) == 4 * 2
    for one, other in zip(coded_frames, filled, strict=True):
        for name, values in vars(one).items():
            for own, theirs in zip(values, vars(other)[name], strict=True):
                np.testing.assert_array_equal(own, theirs, name)


def test_any_frame_is_decoded_alone(tmp_path):
    coded(tmp_path / "a.egs", moving(frames=7), group=3)
    frames = decoded(tmp_path / "a.egs")
    with opened_sequence(tmp_path / "a.egs") as sequence:
        assert sequence.timeline.keys == (0, 3, 6)
        for number, frame in enumerate(frames):
            [alone] = sequence.frames(number, number + 1)
            assert_same_floats(alone, frame)
        assert sequence.at(0.09, 0.2) == range(2, 5)
        assert sequence.at(0.09, 0.21) == range(2, 6)  # frame 5 begins at 0.2
        assert sequence.at(0.0, 0.0) == range(1)
        long = replace(sequence, timeline=replace(sequence.timeline, count=200, rate=(30, 1)))
        assert long.at(4.1, 4.2) == range(123, 126)
        assert long.at(0, 4.1) == range(123)
        with pytest.raises(InvalidInput, match="expected some of 0 to 6"):
            sequence.frames(7)
        with pytest.raises(InvalidInput, match=r"0 to 0\.28 seconds"):
            sequence.at(0.3, 0.4)


def test_other_gaussians_begin_a_group(tmp_path):
    scenes = [*moving(frames=2), *moving(290, frames=2, seed=1)]
    coded(tmp_path / "a.egs", scenes)
    with opened_sequence(tmp_path / "a.egs") as sequence:
        assert sequence.timeline.keys == (0, 2)
        assert [frame.count for frame in sequence.frames()] == [1200, 1200, 290, 290]


def test_unrelated_frames_cost_no_more_than_scenes(tmp_path, monkeypatch):
    monkeypatch.delattr(Pairing, "nearest")  # a sample tells, which is far faster
    scenes = [random_scene(2000, seed=seed) for seed in range(4)]
    report = coded(tmp_path / "a.egs", scenes, block=1000)
    alone = sum(len(encode_scene(s, SmallBlocks("m", block_size=1000))[0]) for s in scenes)
    assert report.key_frames == 4
    assert report.file_bytes < 1.01 * alone


def test_the_order_of_gaussians_in_frames_does_not_matter(tmp_path):
    """Other formats sort each frame, so that an index is another Gaussian in the next."""
    scenes = moving(frames=4)
    ordered = [scenes[0]] + [
        scene.take(spatial_order(scene.positions, scene.log_scale)) for scene in scenes[1:]
    ]
    coded(tmp_path / "a.egs", scenes)
    assert coded(tmp_path / "b.egs", ordered).key_frames == 1
    assert (tmp_path / "a.egs").read_bytes() == (tmp_path / "b.egs").read_bytes()


def test_gaussians_of_a_limb_are_found_again():
    """They move farther than their neighbours are away, in front of others that do not move."""
    scene = random_scene(6000, 0)
    scene.positions[:, :2000] *= 0.25
    angle = 0.1
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = scene.positions.copy()
    moved[:2, :2000] = turn @ moved[:2, :2000] + 0.02
    order = np.random.default_rng(0).permutation(scene.count)
    after = replace(scene, positions=moved).take(order)
    partners = Pairing(scene, after).nearest()
    assert np.mean(order[partners] == np.arange(scene.count)) > 0.995


def test_gaussians_that_look_alike_are_found_again(tmp_path):
    """A sheet of one colour: what a format rounds differs more than neighbours do."""
    rng = np.random.default_rng(0)
    x, y = np.mgrid[:40, :40].reshape(2, -1) / 10
    alike = random_scene(1600, 0)
    for group in ("log_scale", "rot", "opacity", "f_dc"):
        getattr(alike, group)[:] = getattr(alike, group)[:, :1]
    scenes = []
    for time in range(3):
        places = np.float32([x, y, 0.1 * np.sin(x + 0.1 * time)])
        frame = replace(alike, positions=places)
        for group in ("log_scale", "f_dc"):
            rounded = getattr(alike, group) + rng.integers(-1, 2, (3, 1600)) / 64
            frame = replace(frame, **{group: np.float32(rounded)})
        scenes.append(frame.take(rng.permutation(1600)))
    assert coded(tmp_path / "a.egs", scenes).key_frames == 1


def test_discs_turn_by_large_angles(tmp_path):
    """Only two axes show a turn; what is left out about the third must not tilt the disc."""
    rng = np.random.default_rng(0)
    scene = random_scene(1200, 0)
    scene.log_scale[:] = np.array([[-2.0], [-2.001], [-7.0]])
    scene.opacity[:] = 4.0
    scenes = [replace(scene, rot=rng.normal(size=(4, 1200)).astype(np.float32)) for _ in range(2)]
    assert coded(tmp_path / "a.egs", scenes).key_frames == 1

    tilts = []
    for source, frame in zip(scenes, decoded(tmp_path / "a.egs"), strict=True):
        _, found = Neighbours(source.positions.T).nearest(frame.positions.T, 1)
        rotations = source.rot[:, found[:, 0]], frame.rot
        normals = [rotation_matrix(rot / np.linalg.norm(rot, axis=0))[:, 2] for rot in rotations]
        tilts.append(np.linalg.norm(np.cross(*normals, axis=0), axis=0).max())
    assert tilts[1] < 1.5 * tilts[0]


def test_what_appears_at_once_becomes_exact(tmp_path):
    """The steps of a frame's shapes are those of the shapes before, coarse if these hardly show."""
    shown = random_scene(1200, 0)
    hidden = replace(shown, opacity=shown.opacity - 8.0, log_scale=shown.log_scale - 4.0)
    coded(tmp_path / "a.egs", [hidden, shown, shown])
    coded(tmp_path / "b.egs", [shown])
    errors = []
    for frame in (*decoded(tmp_path / "a.egs"), *decoded(tmp_path / "b.egs")):
        _, found = Neighbours(shown.positions.T).nearest(frame.positions.T, 1)
        sizes = [np.sort(scene.log_scale, axis=0) for scene in (frame, shown.take(found[:, 0]))]
        errors.append(np.abs(sizes[0] - sizes[1]).mean())
    assert errors[2] < 1.1 * errors[3] < errors[1]


def test_frames_must_be_alike(tmp_path):
    scenes = [random_scene(20, 3), random_scene(20, 2)]
    with pytest.raises(InvalidInput, match="frame_1: frames differ in SH degree"):
        coded(tmp_path / "a.egs", scenes)
    assert not (tmp_path / "a.egs").exists()


def test_only_the_first_frame_must_have_gaussians(tmp_path):
    full, empty = random_scene(30, 0), random_scene(0, 0)
    coded(tmp_path / "a.egs", [full, empty, full])
    with opened_sequence(tmp_path / "a.egs") as sequence:
        assert [scene.count for scene in sequence.frames()] == [30, 0, 30]
    with pytest.raises(InvalidInput, match="the first frame has no Gaussians"):
        coded(tmp_path / "b.egs", [empty, full])
    assert not (tmp_path / "b.egs").exists()


@pytest.mark.parametrize("fps", [1e-4, 1e7])
def test_frames_per_second_are_checked_before_frames_are_encoded(tmp_path, fps):
    frames = replace(given([random_scene(30, 0)]), fps=fps, open_frame=None)
    with pytest.raises(InvalidInput, match="frames per second, expected"):
        encode_frames(frames, tmp_path / "a.egs", Request(Config()))


def test_bytes_do_not_depend_on_threads(tmp_path):
    scenes = moving()
    for threads in (1, 3):
        config = SmallBlocks("m", block_size=600, threads=threads)
        encode_frames(given(scenes), tmp_path / f"{threads}.egs", Request(config))
    assert (tmp_path / "1.egs").read_bytes() == (tmp_path / "3.egs").read_bytes()


@pytest.mark.parametrize("wish", ["size", "bit_rate", "ratio"])
def test_a_size_is_met(tmp_path, wish):
    scenes = moving(frames=3)
    large = coded(tmp_path / "a.egs", scenes)
    limit = int(0.7 * large.file_bytes)
    target = {
        "size": RateTarget(limit),
        "bit_rate": RateTarget(bit_rate=8 * limit * 25 // 3),
        "ratio": RateTarget(ratio=large.float_bytes / limit),
    }[wish]
    request = Request(SMALL, rate=target)
    report = encode_requested(given(scenes), tmp_path / "b.egs", request)
    assert 0.97 * limit < report.file_bytes <= limit
    assert (tmp_path / "b.egs").stat().st_size == report.file_bytes
    assert report.encodings > 1
    assert len(decoded(tmp_path / "b.egs")) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.egs", "b.egs"]


def test_one_scene_has_no_bit_rate():
    with pytest.raises(InvalidInput, match="target bit_rate: one scene, expected a sequence"):
        RateTarget(bit_rate=9).limit(20, 1)


def test_a_loss_is_met_on_average(tmp_path, monkeypatch):
    scenes = moving(300, frames=3)
    monkeypatch.setattr(frame_targets, "_MEASURED", 2)
    # Step sizes without cameras; the views of all frames are those of the first.
    monkeypatch.setattr(
        frame_encoding, "encode_prepared", lambda scene, request: encode_parts(scene, SMALL)
    )
    views = [replace(as_camera(camera), split="test") for camera in orbit_cameras(2, 48, 32)]
    found = {}

    def losing(report, path, measured):
        assert [each.name for each in measured] == ["frame_0", "frame_2"]
        assert [len(each.views.cameras) for each in measured] == [2, 2]
        drops = with_loss(report, path, measured)
        found[report.coarseness] = drops.psnr_drop
        loss = 0.1 * report.coarseness**1.7  # the encoder above ignores it
        return replace(drops, psnr_drop=loss)

    with_loss = frame_targets._with_loss
    monkeypatch.setattr(frame_targets, "_with_loss", losing)
    request = Request(SMALL, Plan(cameras=views), RateTarget(psnr_drop=0.3))
    report = encode_requested(given(scenes), tmp_path / "a.egs", request)
    assert 0.255 <= report.psnr_drop <= 0.3
    assert report.worst_frame in ("frame_0", "frame_2")
    assert 0 < min(found.values()) == max(found.values()) <= report.worst_drop


def test_a_loss_without_given_cameras_is_that_of_crops_from_other_places(tmp_path, caplog):
    scenes = moving(400, frames=2)
    request = Request(Config("s"), Plan(views=4, width=80), RateTarget(psnr_drop=1.0))
    report = encode_requested(given(scenes), tmp_path / "a.egs", request)
    pairs = zip(scenes, decoded(tmp_path / "a.egs"), strict=True)
    lost = [Check.by_plan(scene, None).measure(frame).loss for scene, frame in pairs]
    assert report.psnr_drop == pytest.approx(np.mean(lost), rel=1e-6)
    assert report.worst_drop == pytest.approx(max(lost), rel=1e-6)
    assert 0.5 < report.psnr_drop <= 1.0
    assert report.encodings > 1
    [said] = [text for text in caplog.messages if "estimated" in text]  # not by each encoding
    assert said.endswith("encoded camera-free")


def test_an_interrupted_run_goes_on(tmp_path):
    scenes = moving(frames=6)
    coded(tmp_path / "whole.egs", scenes, group=4)
    read: list[int] = []

    def failing(number: int) -> Scene:
        read.append(number)
        if number == 5 and read.count(5) == 2:
            raise KeyboardInterrupt
        return scenes[number]

    request = Request(SmallBlocks("m", block_size=600))
    frames = replace(given(scenes, failing), paths=[tmp_path / "whole.egs"])
    with pytest.raises(KeyboardInterrupt):
        encode_frames(frames, tmp_path / "a.egs", request, 4)
    assert not (tmp_path / "a.egs").exists()
    read.append(-1)
    encode_frames(frames, tmp_path / "a.egs", request, 4)
    assert (tmp_path / "a.egs").read_bytes() == (tmp_path / "whole.egs").read_bytes()
    assert read[read.index(-1) + 1 :] == [4, 5]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.egs", "whole.egs"]


def test_a_run_with_other_cameras_begins_again(tmp_path, monkeypatch):
    found = []

    def stop(target: Path, identity: dict) -> None:
        found.append(identity)
        raise KeyboardInterrupt

    monkeypatch.setattr(frame_encoding, "work_folder", stop)
    frames, cameras = given(moving(frames=2)), tmp_path / "cameras.json"
    frames = replace(frames, paths=[tmp_path])
    for text in ("[]", "[]", "[ ]"):
        if not cameras.exists() or cameras.read_text() != text:
            cameras.write_text(text)
        with pytest.raises(KeyboardInterrupt):
            encode_frames(frames, tmp_path / "a.egs", Request(SMALL, Plan(cameras=cameras)))
    assert found[0]["files"][1:] == found[1]["files"][1:] != found[2]["files"][1:]


def test_frames_in_memory_are_not_those_of_an_earlier_run(tmp_path):
    scenes, others = moving(frames=3), moving(frames=3, seed=1)
    read: list[int] = []

    def failing(number: int) -> Scene:
        read.append(number)
        # The first time is for step sizes.
        if read[-4:].count(2) == 2:
            raise KeyboardInterrupt
        return others[number]

    with pytest.raises(KeyboardInterrupt):
        encode_frames(given(others, failing), tmp_path / "a.egs", Request(SMALL), 1)
    assert read == [0, 1, 2, 0, 1, 2]
    for name in ("whole.egs", "a.egs"):
        encode_frames(given(scenes), tmp_path / name, Request(SMALL), 1)
    assert (tmp_path / "a.egs").read_bytes() == (tmp_path / "whole.egs").read_bytes()


def test_turns_between_rotations():
    rng = np.random.default_rng(3)
    log_scale = rng.normal(size=(3, 50)).astype(np.float32)
    rot = rng.normal(size=(4, 50)).astype(np.float32)
    order, _, _ = sort_axes(log_scale, rot)
    unit = reordered(rot, order)
    # The same ellipsoid: columns of the rotation change places, up to their signs.
    columns = rotation_matrix(unit), rotation_matrix(rot / np.linalg.norm(rot, axis=0))
    expected = np.take_along_axis(columns[1], order[None].astype(np.int64), axis=1)
    np.testing.assert_allclose(np.abs(columns[0]), np.abs(expected), atol=1e-6)
    assert np.abs(turns_between(unit, unit)).max() < 1e-12
    flipped = np.stack([-unit[1], unit[0], unit[3], -unit[2]])
    assert np.abs(turns_between(unit, flipped)).max() < 1e-12


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    for number, scene in enumerate(moving(frames=4), 9):
        write_ply(tmp_path / "frames" / f"f{number}.ply", scene)
    return Folder(tmp_path, monkeypatch, capsys)


def test_commands(folder, caplog):
    result = folder.run("encode", "frames/*.ply", "a.egs", "--fps", "24", "--group", "2")
    assert result.status == 0
    assert result.out.startswith("a.egs: 4 frames at 24 fps, 1,200 Gaussians, ")
    assert "\n2 key frames, " in result.out
    shown = json.loads(folder.run("inspect", "a.egs", "--json").out)
    assert (shown["frames"], shown["fps"]) == (4, 24)
    assert (shown["gaussians"], shown["sh_degree"]) == (1200, 3)
    assert [group["name"] for group in shown["groups"]] == ["f9", "f11"]
    assert "key frame  name" in folder.run("inspect", "a.egs").out
    assert "sound" in folder.run("verify", "a.egs").out
    assert folder.run("decode", "a.egs").status == 0
    names = sorted(path.name for path in (folder.path / "a").iterdir())
    assert names == ["f10.ply", "f11.ply", "f12.ply", "f9.ply"]
    assert folder.run("decode", "a.egs", "one.ply", "--frame", "2").status == 0
    assert (folder.path / "one.ply").read_bytes() == (folder.path / "a/f11.ply").read_bytes()
    assert folder.run("decode", "a.egs", "b", "--time", "0.05-0.1").status == 0
    assert sorted(path.name for path in (folder.path / "b").iterdir()) == ["f10.ply", "f11.ply"]
    assert folder.run("convert", "a.egs", "first.ply").status == 0
    assert "the first of 4 frames is read" in caplog.text
    assert is_sequence("a.egs")
    assert not is_sequence("first.ply")


def test_a_sequence_from_stdin_is_decoded(folder):
    folder.run("encode", "frames", "a.egs")
    folder.run("decode", "a.egs", "one.ply", "--frame", "1")
    stdin = io.TextIOWrapper(io.BytesIO(Path("a.egs").read_bytes()))
    folder.monkeypatch.setattr(sys, "stdin", stdin)
    assert folder.run("decode", "-", "piped.ply", "--frame", "1").status == 0
    assert Path("piped.ply").read_bytes() == Path("one.ply").read_bytes()


def test_a_sequence_from_stdin_is_encoded(folder):
    folder.run("encode", "frames", "a.egs", "--fps", "24")
    folder.run("encode", "a.egs", "b.egs", "-p", "s")
    stdin = io.TextIOWrapper(io.BytesIO(Path("a.egs").read_bytes()))
    folder.monkeypatch.setattr(sys, "stdin", stdin)
    shown = json.loads(folder.run("encode", "-", "piped.egs", "-p", "s", "--json").out)
    assert (shown["input"], shown["frames"], shown["fps"]) == ("-", 4, 24)
    assert Path("piped.egs").read_bytes() == Path("b.egs").read_bytes()


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("encode frames a.egs --target-bpg 9", "--target-bpg has no effect on a sequence"),
        ("encode frames a.egs --target-ratio 1000", "target: unreachable, expected at least "),
        ("encode frames a.egs --target-bitrate 9Mbit", "expected a bit rate, for example 20Mbit/s"),
        ("encode frames/f9.ply a.egs --target-bitrate 9M", "--target-bitrate has no effect on"),
        ("encode frames a.egs --prune 10", "--prune has no effect on a sequence"),
        ("encode frames a.egs --scale 2", "error: --scale 2: has no effect on a sequence"),
        ("encode frames a.spz", "a.spz: frames are encoded to an .egs"),
        ("encode frames -", "-: stdout is for one scene, expected a name"),
        ("encode frames a.egs --strict", "strict: has no effect on a sequence without cameras"),
        ("encode frames a.egs -p lossless", "a.egs: frames are encoded to an .egs by profile"),
        ("encode frames a.egs --group 0", "--group 0: expected"),
        ("encode frames a.egs --fps 0", "--fps 0.0: expected 0.001 to a million"),
        ("encode frames/f9.ply a.egs --fps 3", "--fps has no effect on frames/f9.ply"),
        ("encode 'x*.ply' a.egs", "no frames"),
        ("decode frames/f9.ply --frame 3", "--frame has no effect on frames/f9.ply"),
    ],
)
def test_refused(folder, typed, said):
    line = folder.refuse(*typed.replace("'", "").split())
    assert said in line


def test_a_sequence_of_one_frame_is_reported(folder):
    """The folder of a trainer's only scene is one, too."""
    hint = "a sequence of one frame; name its file to encode it as a scene"
    assert hint not in folder.run("encode", "frames", "a.egs").err
    for number in (9, 10, 11):
        (folder.path / f"frames/f{number}.ply").unlink()
    assert f"frames: {hint}\n" in folder.run("encode", "frames", "b.egs").err
    assert is_sequence("b.egs")


def test_sequences_are_encoded_again(folder):
    folder.run("encode", "frames", "a.egs", "--fps", "24", "--group", "3")
    result = folder.run("encode", "a.egs", "b.egs", "--coarseness", "3", "--json")
    shown = json.loads(result.out)
    assert (shown["frames"], shown["fps"]) == (4, 24)
    assert shown["input_bytes"] == (folder.path / "a.egs").stat().st_size
    assert shown["output_bytes"] < 0.8 * shown["input_bytes"]
    assert shown["ratio"] == shown["float_bytes"] / shown["output_bytes"]
    [first, second] = ([s.positions for s in decoded(folder.path / f"{n}.egs")] for n in "ab")
    for one, other in zip(first, second, strict=True):
        assert 0 < np.abs(one.mean(axis=1) - other.mean(axis=1)).max() < 0.01
    frames = open_frames(folder.path / "a.egs")
    for number in (2, 3, 0):
        assert np.array_equal(frames.read(number).positions, first[number])
    said = folder.refuse("encode", "a.egs", "a.egs", "--overwrite")
    assert "input and output are the same file" in said
    said = folder.refuse("convert", "a.egs", "c")
    assert "a.egs is a sequence: `decode` writes its frames to a folder" in said


SEVERAL = ["frames", "frames/*.ply", "frames.zip"]


@pytest.mark.parametrize("source", SEVERAL)
def test_frames_that_are_not_encoded(folder, source):
    zipped("frames.zip")
    shown = json.loads(folder.run("inspect", source, "--json").out)
    assert (shown["frames"], shown["names"], shown["fps"]) == (4, ["f9", "f10", "f11", "f12"], None)
    assert (shown["gaussians"], shown["sh_degree"]) == (1200, 3)
    said = folder.run("inspect", source).out
    assert f"{source}: 4 frames, 1.14 MB; `encode` makes a sequence of them\nfirst frame 'f" in said
    said = folder.run("verify", source).out
    assert f"{source}: sound, 1.14 MB, 4 frames, 4,800 Gaussians in all, " in said
    (folder.path / "frames/f11.ply").write_text("ply")
    zipped("frames.zip")
    assert "f11.ply: " in folder.refuse("verify", source)


@pytest.mark.parametrize("source", SEVERAL)
@pytest.mark.parametrize(
    "typed",
    [
        "decode {} x.ply", "share {} --out x.html", "convert {} x.ply", "inspect {} --histogram",
        "render {} --cameras auto --out x", "analyze {} --out x", "prepare {} x.ply --prune 9",
    ],
)  # fmt: skip
def test_frames_are_not_one_scene(folder, source, typed):
    zipped("frames.zip")
    said = folder.refuse(*(word.format(source) for word in typed.split()))
    kind = {"frames": "folder", "frames.zip": "zip"}.get(source, "pattern")
    assert f"{source}: a {kind} of 4 files, expected one file; if they are the frames" in said
    assert [path.name for path in folder.path.iterdir() if path.name.startswith("x")] == []


def test_a_zip_of_tiles_has_no_frames(folder):
    (folder.path / "frames/tileset.json").write_text("{}")
    zipped("frames.zip")
    for typed in ("inspect frames.zip", "encode frames.zip x.egs", "convert frames.zip x.ply"):
        said = folder.refuse(*typed.split())
        assert "frames.zip: a zip without meta.json, expected a SOG scene; unpack others" in said


def zipped(path) -> None:
    """Zip the files of the folder `frames`."""
    with zipfile.ZipFile(path, "w") as archive:
        for each in Path("frames").iterdir():
            archive.write(each)


def test_compare_frames(folder):
    folder.run("encode", "frames", "a.egs")
    (folder.path / "frames" / "f12.ply").rename(folder.path / "f12.ply")
    said = folder.refuse("compare", "frames", "a.egs", "--cameras", "auto")
    assert "a.egs: 4 frames, expected 3, as in frames" in said
    (folder.path / "f12.ply").rename(folder.path / "frames" / "f12.ply")
    result = folder.run("compare", "frames", "a.egs", "--width", "40", "--json")
    shown = json.loads(result.out)
    assert [frame["name"] for frame in shown["frames"]] == ["f9", "f10", "f11", "f12"]
    assert all(30 < frame["psnr"] < 80 for frame in shown["frames"])
    result = folder.run("compare", "frames/*.ply", "a.egs", "--width", "40")
    assert result.out.splitlines()[-1].startswith("4 frames: ")
    assert "--lpips has no effect" in folder.refuse("compare", "frames", "a.egs", "--lpips", "x")


def test_refused_of_sequences(folder):
    folder.run("encode", "frames", "a.egs")
    for typed, said in (
        (["--level", "1"], "--level has no effect on a.egs, a sequence"),
        (["x.ply"], "x.ply: a file, expected a folder for the frames, or one frame"),
        (["-"], "-: stdout is for one scene, expected a name"),
        (["x.ply", "--frame", "4"], "frames 4 to 4: expected some of 0 to 3"),
        (["--time", "soon"], "--time soon: expected START-END in seconds"),
        (["--time", f"0-{'9' * 400}"], "expected START-END in seconds"),
        (["--time", "9-10"], "time 9-10: expected some of 0 to 0.133333 seconds"),
        (["x.ply", "--frame", "1", "--time", "0-1"], "--frame and --time cannot be combined"),
    ):
        assert said in folder.refuse("decode", "a.egs", *typed)
    assert "--gpu has no effect on a.egs" in folder.refuse("inspect", "a.egs", "--gpu")
