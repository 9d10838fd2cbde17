"""torchac as the coder of profiles `paper-*`: the same floats as with rANS, and clean errors."""

from __future__ import annotations

import json
import os
import struct
import sys
from dataclasses import replace

import numpy as np
import pytest
from damage import with_section
from reference_decoder import decode as reference_decode
from scenes import assert_same_floats, edge_scenes, random_scene
from typer.testing import CliRunner

from gs_codec.cli.main import app
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.decode import decode_part
from gs_codec.codecs.entropygs import torchac_coder
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.memory_limit import least_memory
from gs_codec.codecs.part import Part
from gs_codec.config import DEPTH_GROUPS, LOSSLESS, PROFILE_CHOICES, PROFILES, Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.egs.header import Feature
from gs_codec.errors import CorruptStream, InvalidInput, MissingTool, TruncatedStream
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.optional import is_available

HERE = is_available("torch", "torchac")
EDGES = edge_scenes()


def needs_torchac(test):
    """A test of torchac itself; its first import compiles for half a minute."""
    return pytest.mark.thorough(
        pytest.mark.skipif(not HERE, reason="torchac is not installed")(test)
    )


def config(profile="paper-m", **options):
    return Config(profile, coder="torchac", block_size=1024, **options)


def both(scene, **options):
    """A torchac file, which decodes to the floats of the rANS file, and the latter."""
    theirs, report = encode_scene(scene, config(**options))
    ours = encode_scene(scene, replace(config(**options), coder="rans"))[0]
    assert report.file_bytes == len(theirs)
    assert "states" not in report.section_bytes
    assert_same_floats(decode_scene(theirs), decode_scene(ours))
    return theirs, ours


@needs_torchac
@pytest.mark.parametrize("name", EDGES)
def test_edge_scenes_decode_like_rans(name):
    data, _ = both(EDGES[name])
    assert reference_decode(data)["count"] == EDGES[name].count


@needs_torchac
@pytest.mark.parametrize(
    ("profile", "models"),
    [("paper-l", "parametric"), ("paper-m", "table"), ("paper-s", "best")],
)
def test_blocks_decode_like_rans_and_the_reference_decoder(profile, models):
    scene = random_scene(1100, 3, seed=70)
    data, _ = both(scene, profile=profile, models=models)
    values, decoded = reference_decode(data)["values"], decode_scene(data)
    names = {
        "opacity": decoded.opacity[0],
        "rot_3": decoded.rot[3],
        "f_rest_44": decoded.f_rest[44],
    }
    for name, row in names.items():
        np.testing.assert_array_equal(values[name].view(np.uint32), row.view(np.uint32))


@needs_torchac
@pytest.mark.parametrize("bits", [1, 12])
def test_depths_decode_like_rans(bits):
    """With 12 bits, a block takes two runs."""
    data, _ = both(random_scene(1100, 1, seed=71), depths=dict.fromkeys(DEPTH_GROUPS, bits))
    assert reference_decode(data)["count"] == 1100


@needs_torchac
def test_sizes_are_nearly_those_of_rans():
    scene = random_scene(20_000, 1, seed=72)
    sizes = []
    for coder in ("torchac", "rans"):
        _, report = encode_scene(scene, Config("paper-m", coder=coder))
        streams = {cost.stream for cost in report.costs} | {"states"}
        sizes.append(sum(report.section_bytes.get(name, 0) for name in streams))
        assert sum(cost.coded_bits for cost in report.costs) / 8 < sizes[-1]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.002)


@needs_torchac
def test_threads_and_repetition_change_nothing():
    scene = random_scene(3000, 1, seed=73)
    files = [encode_scene(scene, config(threads=threads))[0] for threads in (1, 2, 7, 2)]
    assert len(set(files)) == 1
    for threads in (2, 5):
        assert_same_floats(decode_scene(files[0], threads), decode_scene(files[0], 1))


@needs_torchac
def test_parts_decode_like_rans():
    scene = random_scene(3000, 2, seed=74)
    low, high = np.quantile(scene.positions, [0.1, 0.4], axis=1)
    part = Part((*low, *high), sh_degree=1)
    files = both(scene)
    parts = [decode_part(data, part)[0] for data in files]
    assert 0 < parts[0].count < scene.count
    assert_same_floats(*parts)


@needs_torchac
def test_inspect_names_the_coder(tmp_path):
    path = tmp_path / "scene.egs"
    path.write_bytes(encode_scene(random_scene(300, 1, seed=75), config())[0])
    told = inspect_bytes(path.read_bytes()).coder
    assert told.startswith("torchac 0.")
    result = CliRunner().invoke(app, ["inspect", str(path)])
    assert "profile paper-m with torchac, 300 Gaussians" in result.stdout
    assert f"attributes: coded by '{told}'" in result.stdout
    listed = CliRunner().invoke(app, ["inspect", str(path), "--json"])
    assert json.loads(listed.stdout)["coder"] == told


def test_inspect_names_the_other_coders():
    scene = random_scene(50, 1, seed=76)
    for profile in PROFILE_CHOICES:
        coder = inspect_bytes(encode_scene(scene, Config(profile))[0]).coder
        assert coder == ("pcodec" if profile == LOSSLESS else "rans")


@needs_torchac
def test_readers_without_the_feature_refuse_it():
    file = read_file(encode_scene(random_scene(50, 0, seed=77), config())[0])
    entries = file.header_size - 4 - 20 * len(file.table)
    table = bytes(file.data[entries : file.header_size - 4])
    rows = [struct.unpack("<HH", table[i : i + 4]) for i in range(0, len(table), 20)]
    assert (SectionId.CODER, 0) in rows, "present, and not optional"
    assert file.header.features == Feature.TORCHAC


# Refusals


@pytest.mark.parametrize("profile", sorted({*PROFILE_CHOICES} - {*PROFILES}))
@pytest.mark.parametrize("option", [{"coder": "torchac"}, {"models": "best"}])
def test_other_profiles_have_neither(option, profile):
    with pytest.raises(InvalidInput, match=f"profile '{profile}', expected paper-l, paper-m"):
        Config(profile, **option)


@pytest.fixture
def absent(monkeypatch):
    """torchac is not installed."""
    monkeypatch.setitem(sys.modules, "torchac", None)
    torchac_coder._load.cache_clear()
    yield
    torchac_coder._load.cache_clear()


def test_without_it_encoding_is_one_clear_error(absent, tmp_path):
    source, target = tmp_path / "a.ply", tmp_path / "a.egs"
    write_ply(source, random_scene(20, 0, seed=78))
    options = ["encode", str(source), str(target), "-p", "paper-m", "--coder", "torchac"]
    result = CliRunner().invoke(app, options)
    assert isinstance(result.exception, MissingTool)
    assert "a.ply: coder 'torchac': needs torchac; pip install 'gs-codec[paper]'" in str(
        result.exception
    )
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


@needs_torchac
def test_without_it_a_file_can_be_inspected_but_not_decoded(request):
    data = encode_scene(random_scene(20, 0, seed=79), config())[0]
    request.getfixturevalue("absent")
    assert inspect_bytes(data).coder.startswith("torchac")
    with pytest.raises(MissingTool, match="needs torchac; pip install"):
        decode_scene(data)


def test_memory_for_torch_is_counted():
    plain = least_memory(1000, Config("paper-m"))
    assert least_memory(1000, Config("paper-m", coder="torchac")) > plain + 100_000_000


# Streams that lie


LIES = {
    "cut": (SectionId.OPACITY, lambda part: part[:-1], TruncatedStream, "bytes left at"),
    "grown": (SectionId.OPACITY, lambda part: part + b"\0", CorruptStream, "other symbols"),
    "checksum": (SectionId.SH1, lambda part: bytes(4) + part[4:], CorruptStream, "other symbols"),
    "bit": (
        SectionId.ROTATION, lambda part: part[:40] + bytes([part[40] ^ 4]) + part[41:],
        CorruptStream, "other symbols",
    ),
    "size": (
        SectionId.SCALING, lambda part: part[:4] + b"\xff\xff\xff\xff" + part[8:],
        TruncatedStream, "expected 4,294,967,295",
    ),
    "empty": (SectionId.OPACITY, lambda _: b"", TruncatedStream, "expected 4"),
    "no line": (SectionId.CODER, lambda _: b"", CorruptStream, "section 'coder': 0 bytes"),
    "long line": (SectionId.CODER, lambda _: b"t" * 201, CorruptStream, "'coder': 201 bytes"),
    "escape": (SectionId.CODER, lambda _: b"a\x1b[31m", CorruptStream, "printable ASCII"),
    "not told": (SectionId.CODER, lambda _: None, CorruptStream, "sections of blocks, expected"),
    "stream left out": (SectionId.SH1, lambda _: None, CorruptStream, "sections of blocks"),
}  # fmt: skip


@needs_torchac
@pytest.mark.parametrize("lie", LIES)
def test_inconsistent_streams_are_refused(lie):
    section, change, kind, message = LIES[lie]
    data = encode_scene(random_scene(900, 1, seed=80), config())[0]
    data = with_section(data, section, change)
    with pytest.raises(kind, match=message):
        decode_scene(data)
    with pytest.raises(ValueError, match=r"section|coder"):
        reference_decode(data)


@needs_torchac
def test_states_beside_it_are_refused():
    data = encode_scene(random_scene(90, 1, seed=81), config())[0]
    with pytest.raises(CorruptStream, match="section 'states' of block 0: empty"):
        decode_scene(with_section(data, SectionId.STATES, lambda _: bytes(4)))


@pytest.mark.parametrize("profile", ["paper-m", "m", LOSSLESS])
def test_a_coder_of_nothing_is_refused(profile):
    data = encode_scene(random_scene(0), Config(profile))[0]
    with pytest.raises(CorruptStream, match="section 'coder' of block 0: empty"):
        decode_scene(with_section(data, SectionId.CODER, lambda _: b"torchac 0.9.3"))


@needs_torchac
@pytest.mark.rounds(20)
def test_random_bytes_are_refused(seed):
    """Whatever the bytes: no crash, and no symbols that contradict the checksum."""
    rng = np.random.default_rng(seed)
    data = encode_scene(random_scene(40, 1, seed=82), config())[0]
    streams = {SectionId.OPACITY, SectionId.SCALING, SectionId.ROTATION, SectionId.SH1}
    noise = rng.integers(0, 256, 5000, np.uint8).tobytes()
    chosen = SectionId(int(rng.choice(sorted(streams))))
    broken = with_section(data, chosen, lambda part: part[:8] + noise[: len(part) - 8])
    with pytest.raises((CorruptStream, TruncatedStream)):
        decode_scene(broken)


def test_ours_needs_no_package(absent):
    scene = random_scene(60, 1, seed=83)
    assert decode_scene(encode_scene(scene, Config("paper-m"))[0]).count == 60


@pytest.fixture
def unloaded():
    """torchac, not yet loaded by this process."""
    torchac_coder._load.cache_clear()
    for name in [name for name in sys.modules if name.startswith("torchac")]:
        del sys.modules[name]


@needs_torchac
def test_output_of_torchac_is_hidden(unloaded, capfd):
    torchac_coder.require_torchac()
    print("after")
    assert capfd.readouterr() == ("after\n", "")


@needs_torchac
def test_a_killed_compilation_does_not_block(unloaded, monkeypatch):
    from torch.utils.file_baton import FileBaton

    def take_and_die(self: FileBaton) -> bool:
        acquired = acquire(self)
        assert acquired
        raise RuntimeError("killed")

    def wait(self: FileBaton) -> None:
        raise AssertionError("waits for ever")

    acquire = FileBaton.try_acquire
    monkeypatch.setattr(FileBaton, "wait", wait)
    monkeypatch.setattr(FileBaton, "try_acquire", take_and_die)
    with pytest.raises(MissingTool, match="killed"):
        torchac_coder.require_torchac()
    monkeypatch.setattr(FileBaton, "try_acquire", acquire)
    environment = dict(os.environ)
    torchac_coder.require_torchac()
    assert os.environ == environment
