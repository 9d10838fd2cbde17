"""The JavaScript decoder, run by Node, gives the same floats as Python's."""

from __future__ import annotations

import re
import struct
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reference_tools
from damage import BASIS, FAR, changed, flipped, sample, with_checksums, with_section
from format_cases import CASES, LATTICE_CASES, encoded, lattice_config
from javascript import BLOCK, COUNT, GOLDEN, NODE, blocks, digest, run, upto
from moving_scenes import coded, moving
from scenes import (
    edge_scenes,
    encode_by,
    made_up_guide,
    random_scene,
    seen_from,
    shared_scene_path,
    with_far,
)

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import ADAPTIVE_PROFILES, Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.errors import GsCodecError
from gs_codec.files.decode_file import decode_file
from gs_codec.formats.ply.file import read_ply
from gs_codec.scene import other_comments

pytestmark = pytest.mark.skipif(NODE is None, reason="needs Node")

HERE = Path(__file__).parent


def assert_same(found: dict, data: bytes) -> None:
    """The result of a job equals that of the Python decoder."""
    scene = decode_scene(data)
    assert "error" not in found, found
    assert (found["count"], found["degree"]) == (scene.count, scene.sh_degree)
    assert found["hash"] == found["properties"] == digest(scene)
    assert found["coordinates"] == scene.coordinates
    assert found["antialiased"] == scene.antialiased
    assert found["comments"] == list(other_comments(scene.comments))


def test_golden_files():
    for path, found in zip(GOLDEN, run(*({"path": str(path)} for path in GOLDEN)), strict=True):
        if "lossless" in path.stem:
            assert found["error"] == "UnsupportedError"
            assert "pcodec" in found["message"]
        else:
            assert_same(found, path.read_bytes())


@pytest.mark.thorough
def test_cases_of_the_paper_profiles():
    files = [encoded(case)[0] for case in CASES]
    for data, found in zip(files, run(*({"bytes": data} for data in files)), strict=True):
        assert_same(found, data)


@pytest.mark.thorough
def test_cases_of_lattices():
    files = [
        encode_by(make(*arguments), lattice_config(profile), guide)
        for profile in ADAPTIVE_PROFILES
        for make, arguments in LATTICE_CASES.values()
        for guide in (None, made_up_guide(seed=arguments[0]))
    ]
    files += [encode_scene(scene, lattice_config())[0] for scene in edge_scenes().values()]
    for data, found in zip(files, run(*({"bytes": data} for data in files)), strict=True):
        assert_same(found, data)


@pytest.mark.thorough
def test_real_scenes():
    cases = [("tiny_sh3.ply", "l"), ("tiny_sh3.ply", "paper-m"), ("flowers_sh2.ply", "m")]
    files = [
        encode_scene(read_ply(shared_scene_path(name)), Config(profile))[0]
        for name, profile in cases
    ]
    for data, found in zip(
        files, run(*({"bytes": data, "workers": 2} for data in files)), strict=True
    ):
        assert_same(found, data)


@pytest.mark.thorough
@pytest.mark.parametrize("profile", ["m", "paper-m"])
def test_every_kind_of_source_gives_the_same(profile):
    data = blocks(profile)
    kinds = ["bytes", "buffer", "blob", "response", "url", "unranged"]
    jobs = [{"bytes": data, "as": kind} for kind in kinds]
    jobs += [{"bytes": data, "as": "stream", "chunk": size} for size in (7, 1000, len(data))]
    jobs += [{"bytes": data, "as": "buffers", "chunk": size} for size in (999, len(data))]
    jobs += [{"bytes": data, "workers": workers} for workers in (1, 3)]
    jobs += [{"bytes": data, "as": kind} for kind in ("moved", "crossing")]
    for found in run(*jobs):
        assert_same(found, data)
        assert found["alive"] == found["listening"] == 0
        assert found["progress"][-1] == [len(data), len(data)]


def test_the_example_of_the_readme(tmp_path):
    folder = HERE.parent / "viewer" / "web"
    text = (folder / "README.md").read_text().split("## The decoder")[1].split("\n## ")[0]
    lines = re.findall(r"^    (.*)", text, re.MULTILINE)
    code = "\n".join(lines).replace("./src", (folder / "src").as_uri())
    scene, script = tmp_path / "scene.egs", tmp_path / "example.mjs"
    scene.write_bytes(blocks())
    coded(tmp_path / "clip.egs", moving(9, 3))
    for path in (scene, tmp_path / "clip.egs"):
        code = code.replace(f"'{path.name}'", f"fs.readFileSync('{path}')")
    first = "import * as fs from 'node:fs';\nlet shown = 0;\nconst show = () => shown++;\n"
    script.write_text(f"{first}{code}\nconsole.log(shown, scene.count);\n")
    result = subprocess.run([str(NODE), script], capture_output=True, text=True, check=True)
    assert result.stdout.split() == [str(20 + 3), str(COUNT)]


def test_a_ply_is_that_of_python(tmp_path):
    """But for the comment on its order."""
    told = ("a comment", "SplatRenderMode: mip", "CoordinateSystem: RUB")
    (tmp_path / "a.egs").write_bytes(
        encode_scene(replace(random_scene(9, 1), comments=told), Config("m"))[0]
    )
    decode_file(tmp_path / "a.egs", tmp_path / "a.ply")
    folder = HERE.parent / "viewer" / "web" / "src"
    script = f"""
        import * as fs from 'node:fs';
        import {{ decode }} from '{(folder / "index.js").as_uri()}';
        import {{ toPly }} from '{(folder / "ply.js").as_uri()}';
        process.stdout.write(toPly(await decode(fs.readFileSync('{tmp_path / "a.egs"}'))));
    """
    command = [str(NODE), "--input-type=module", "-e", script]
    done = subprocess.run(command, capture_output=True, check=True)
    ours = re.sub(rb"comment gs_codec order .*\n", b"", (tmp_path / "a.ply").read_bytes())
    assert done.stdout == ours


def test_blocks_are_reported_as_they_complete():
    data = blocks()
    (found,) = run({"bytes": data, "as": "stream", "chunk": 100})
    expected = [[k, d, k * BLOCK, BLOCK] for k in range(5) for d in range(4)]
    assert sorted(found["blocks"]) == expected
    # The first block is complete except for SH-AC long before the last block.
    assert [part[:2] for part in found["blocks"][:5]] == [[k, 0] for k in range(5)]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("profile", ["m", "paper-m"])
def test_a_lower_degree_is_that_of_the_scene_and_fetches_less(profile):
    data = blocks(profile)
    scene = decode_scene(data)
    jobs = [{"bytes": data, "as": "stream", "chunk": 50, "shDegree": d} for d in range(4)]
    ends = []
    for degree, found in enumerate(run(*jobs)):
        assert (found["degree"], found["hash"]) == (degree, digest(upto(scene, degree)))
        ends.append(found["progress"][-1][0])
    assert ends == sorted(set(ends))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("profile", ["m", "paper-m"])
def test_a_box_gives_the_blocks_that_meet_it_and_fetches_no_others(profile):
    data = blocks(profile)
    scene = decode_scene(data)
    low, high = [-10.0, -10.0, -10.0], [10.0, 10.0, float(np.quantile(scene.positions[2], 0.02))]
    firsts = range(0, COUNT, BLOCK)
    met = [f for f in firsts if scene.positions[2, f : f + BLOCK].min() <= high[2]]
    assert 0 < len(met) < len(firsts)
    rows = np.concatenate([np.arange(f, f + BLOCK) for f in met])
    jobs = [
        {"bytes": data, "as": kind, "box": [low, high]} for kind in ("bytes", "url", "unranged")
    ]
    by_bytes, by_url, whole = run(*jobs)
    for found in (by_bytes, by_url, whole):
        assert found["hash"] == digest(scene.take(rows))
        assert found["listening"] == 0
    assert sum(end - begin for begin, end in by_url["asked"]) < len(data)
    assert len(whole["asked"]) == 1
    (none,) = run({"bytes": data, "box": [[50, 50, 50], [60, 60, 60]]})
    assert none["count"] == 0


def test_sections_without_bytes_are_not_requested():
    """A server may answer a range without bytes by the whole file, or refuse it."""
    scene = random_scene(3000, 1, seed=3)
    few = np.arange(3000) == scene.positions[2].argmin()
    data = encode_by(replace(scene, f_rest=scene.f_rest * few), Config("paper-m", block_size=1024))
    empty = [block for (_, block), size in read_file(data).sizes.items() if size == 0]
    assert empty
    chosen = {"chosen": [[0, empty[:1]]]}
    here, found = run({"bytes": data, "open": chosen}, {"bytes": data, "as": "url", "open": chosen})
    assert found["decoded"] == here["decoded"]
    assert all(begin < end for begin, end in found["asked"])


def test_impossible_requests_are_reported():
    data = blocks()
    future, features = bytearray(data), bytearray(data)
    future[8], features[24] = 3, 32
    paper = encode_scene(random_scene(40, 1), Config("paper-m"))[0]
    jobs = [
        ({"bytes": future}, "UnsupportedError", "header: version 3"),
        (
            {"bytes": with_checksums(features)},
            "UnsupportedError",
            "header: features 5",
        ),
        ({"bytes": b"ply\n" * 9}, "CorruptError", "not an .egs file"),
        ({"bytes": b""}, "CorruptError", "cut off before byte 16"),
        ({"bytes": data + b"\0\0\0\0"}, "CorruptError", "bytes after the last section"),
        ({"bytes": data, "maxBytes": 1000}, "TooLargeError", "at most 1000"),
        ({"bytes": data, "as": "missing"}, "SourceError", "404"),
        ({"bytes": data, "as": "stream", "chunk": 99, "broken": 9000}, "SourceError", "reset"),
        ({"bytes": data, "as": "aborted"}, "AbortError", "aborted"),
        ({"bytes": data, "as": "number"}, "TypeError", "expected an ArrayBuffer"),
        (
            {"bytes": with_section(paper, SectionId.CODER, lambda _: b"x")},
            "UnsupportedError",
            "torchac",
        ),
    ]
    for (_, error, text), found in zip(jobs, run(*(job for job, _, _ in jobs)), strict=True):
        assert found.get("error") == error, found
        assert text in found["message"]


WHOLE = [[-1e9] * 3, [1e9] * 3]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("answer", "error", "text"),
    [
        ("longer", "SourceError", "more bytes than were asked for"),
        ("shorter", "CorruptError", "cut off before byte 16"),
        ("others", "CorruptError", "not an .egs file"),
        ("none", "CorruptError", "cut off before byte 16"),
        ("failing", "SourceError", "503 Service Unavailable"),
        ("cut", "SourceError", "connection lost"),
        ("silent", "SourceError", "no data for 20 seconds"),
        ("halting", "SourceError", "lost at byte 1: no data for 20 seconds"),
    ],
)
def test_servers_with_wrong_answers_to_ranges(answer, error, text):
    (found,) = run({"bytes": blocks(), "as": "url", "answer": answer, "box": WHOLE})
    assert found.get("error") == error, found
    assert text in found["message"]


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [0, 2])
def test_a_signal_ends_pending_work(workers):
    data = blocks()
    stalled = {"chunk": 1000, "stalled": len(data) // 2}
    cases = [{"abort": "before"}, {"abort": "progress"}, {"abort": "block"}]
    cases += [{"abort": "stalled", **stalled}, {"abort": "stalled", **stalled, "reason": "mine"}]
    jobs = [{"bytes": data, "as": "aborted", "workers": workers, **case} for case in cases]
    for job, found in zip(jobs, run(*jobs), strict=True):
        expected = "Error" if "reason" in job else "AbortError"
        assert (found.get("error"), found["alive"]) == (expected, 0), (job, found)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("workers", [0, 2])
def test_errors_end_pending_work(workers):
    """Errors of a damaged block while no more data come, and errors of callbacks."""
    damaged = with_section(blocks(), SectionId.OPACITY, lambda old: old[:-1])
    jobs = [
        {"bytes": damaged, "as": "stream", "chunk": 1000, "stalled": 4 * len(damaged) // 5},
        {"bytes": blocks(), "as": "thrown"},
        {"bytes": blocks(), "as": "text", "chunk": 1000},
    ]
    found = run(*({**job, "workers": workers} for job in jobs))
    assert [each["error"] for each in found] == ["CorruptError", "Error", "TypeError"]
    assert [each["alive"] for each in found] == [0, 0, 0]
    assert found[0]["where"] == "opacity"


@pytest.mark.parametrize("workers", [0, 2])
def test_damaged_blocks_are_skipped_on_request(workers):
    """Detected by checksum or while decoding; in the first part, or only in SH-AC."""
    whole = blocks()
    table = read_file(whole).table
    [every] = run({"bytes": whole})
    shared = bytes(flipped(whole, 8 * table[SectionId.LATTICE, 0].position))
    jobs = {
        "opacity": flipped(whole, 8 * table[SectionId.OPACITY, 1].position),
        "sh1": flipped(whole, 8 * table[SectionId.SH1, 1].position),
        "decoded": with_section(whole, SectionId.OPACITY, lambda old: old[:-1], 1),
    }
    damaged = [{"bytes": bytes(data), "damage": True, "workers": workers} for data in jobs.values()]
    *found, refused = run(*damaged, {"bytes": shared, "damage": True, "workers": workers})
    for name, told in zip(jobs, found, strict=True):
        left = [one for one in every["blocks"] if one[0] != 1 or (name == "sh1" and one[1] == 0)]
        assert sorted(told["blocks"]) == sorted(left), name
        [[block, where]] = told["damage"]
        assert block == 1
        assert where.startswith("opacity" if name == "decoded" else f"section {name} of block 1")
    assert (refused["error"], refused["alive"]) == ("CorruptError", 0)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("kind", ["missing", "refused"])
@pytest.mark.parametrize("source", [{}, {"as": "stream", "chunk": 2000}])
def test_workers_that_cannot_be_created(kind, source):
    (found,) = run({"bytes": blocks(), "workers": 3, "createWorker": kind, **source})
    assert (found.get("error"), found["alive"]) == ("WorkerError", 0), found


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "options",
    [
        {"shDegree": -1},
        {"shDegree": 1.5},
        {"box": None},
        {"box": [0, 0, 0, 1, 1, 1]},
        {"box": [[0, 0, 0], [1, 1, "1"]]},
        {"maxBytes": "much"},
    ],
    ids=str,
)
def test_invalid_options_are_refused(options):
    (found,) = run({"bytes": blocks(), **options})
    assert found.get("error") == "RangeError", found


def test_impossible_header_sizes():
    data = bytearray(blocks())
    for size in (0, 15, 47, 49):
        data[12:16] = size.to_bytes(4, "little")
        for found in run({"bytes": data}, {"bytes": data, "as": "stream", "chunk": 99}):
            assert (found["error"], found["message"]) == (
                "CorruptError",
                f"header: {size} bytes",
            )


@pytest.mark.thorough
def test_a_long_comment_of_spaces_takes_no_time_to_search():
    data = with_section(blocks(), SectionId.COMMENTS, lambda _: b"a" + b" " * 1000000 + b"b")
    (found,) = run({"bytes": data})
    assert_same(found, data)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("seed", range(4))
def test_tables_of_many_rare_symbols(seed):
    """Nearly all take slots from the frequent symbols, some of which are tied."""
    rng = np.random.default_rng(seed)
    cases = []
    for size, precision in ((1, 8), (5, 8), (256, 8), (300, 9), (4096, 12), (4096, 13)):
        weights = np.ones(size, np.int64)
        frequent = rng.integers(size, size=1 + size // 50)
        weights[frequent] = rng.choice([1 << 20, 1 << 31, (1 << 32) - 1], len(frequent))
        weights[rng.integers(size, size=size // 9)] = 0
        cases.append({"weights": weights.tolist(), "precision": precision})
    for case, found in zip(cases, run(*cases), strict=True):
        expected = reference_tools.frequencies(case["weights"], case["precision"])
        assert found["frequencies"] == expected


def test_errors_are_the_same_in_workers():
    content = {}
    for section in (SectionId.OPACITY, SectionId.LATTICE):
        content[section] = with_section(
            blocks(), section, lambda old: old[:-1] + bytes([old[-1] ^ 1])
        )
    jobs = [{"bytes": data, "workers": n} for data in content.values() for n in (0, 2)]
    found = [(each["error"], each["message"]) for each in run(*jobs)]
    assert found[0] == found[1]
    assert found[2] == found[3]
    assert {error for error, _ in found} == {"CorruptError"}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("profile", ["m", FAR, BASIS, "paper-m"])
def test_every_truncation_is_refused(profile):
    data = sample(profile)
    jobs = [{"bytes": data[:size]} for size in range(len(data))]
    for size, found in enumerate(run(*jobs)):
        assert found.get("error") == "CorruptError", (size, found)


def decoded(data: bytes) -> str | None:
    """Digest of Python's result; None if it rejects the file."""
    try:
        return digest(decode_scene(data, 1, 1 << 20))
    except GsCodecError:
        return None


@pytest.mark.one_in(2)
@pytest.mark.parametrize("right", [False, True], ids=["wrong checksums", "right checksums"])
@pytest.mark.parametrize("profile", ["m", FAR, BASIS, "paper-m"])
def test_damage_is_refused_or_decodes_like_in_python(profile, right):
    rng = np.random.default_rng(71)
    extra = {"label": np.arange(40, dtype="<i4"), "mark": rng.integers(0, 9, 40).astype("<u2")}
    scene = replace(random_scene(40, 2, seed=60), extra=extra)
    if profile == FAR:
        profile, scene = "m", with_far(scene, 12)
    if profile == BASIS:
        profile, scene = "m", seen_from(scene, 1, scale=100.0)
    data = encode_scene(scene, Config(profile, block_size=1024, extra="keep"))[0]
    files = [bytes(changed(data, rng)) for _ in range(300)]
    files = [with_checksums(each) if right else each for each in files]
    refused = 0
    for each, found in zip(
        files, run(*({"bytes": f, "maxBytes": 1 << 20} for f in files)), strict=True
    ):
        expected = decoded(each)
        if expected is None:
            refused += 1
            kinds = ["CorruptError", "UnsupportedError", "TooLargeError"]
            assert found.get("error") in kinds, found
        else:
            assert found.get("hash") == expected, found
    assert refused > 200


def one_property(name: bytes = b"mark", kind: int = 1, packed: bytes | None = None) -> bytes:
    """A section `extra` with one property of 5 Gaussians."""
    packed = zlib.compress(bytes(5)) if packed is None else packed
    head = struct.pack("<B", len(name)) + name + struct.pack("<BQ", kind, len(packed))
    return struct.pack("<H", 1) + head + packed


EXTRA = {
    "as it is": (one_property(), None),
    "no bytes": (b"", "CorruptError"),
    "no properties": (bytes(2), "CorruptError"),
    "a name of the layout": (one_property(b"f_rest_77"), "CorruptError"),
    "an empty name": (one_property(b""), "CorruptError"),
    "a name of other bytes": (one_property(b"\xc3\xa9"), "CorruptError"),
    "another type": (one_property(kind=8), "CorruptError"),
    "twice": (b"\x02\x00" + 2 * one_property()[2:], "CorruptError"),
    "one more stated": (b"\x02\x00" + one_property()[2:], "CorruptError"),
    "bytes left": (one_property() + b"\x00", "CorruptError"),
    "too few values": (one_property(packed=zlib.compress(bytes(4))), "CorruptError"),
    "too many values": (one_property(packed=zlib.compress(bytes(1 << 24))), "CorruptError"),
    "no zlib stream": (one_property(packed=b"12345678"), "CorruptError"),
    "nothing": (one_property(packed=b""), "CorruptError"),
    "cut off": (one_property(packed=zlib.compress(bytes(5))[:-1]), "CorruptError"),
    "wrong sum": (one_property(packed=zlib.compress(bytes(5))[:-1] + b"\x77"), "CorruptError"),
    "bytes after": (one_property(packed=zlib.compress(bytes(5)) + b"\x00"), "CorruptError"),
    "another stream": (one_property(packed=2 * zlib.compress(bytes(5))), "CorruptError"),
}


def test_extra_properties_are_checked_like_in_python():
    data = sample("m")
    files = [with_section(data, SectionId.EXTRA, lambda _, e=e: e) for e, _ in EXTRA.values()]
    whole = run(*({"bytes": each, "maxBytes": 1 << 20} for each in files))
    parts = run(*({"bytes": each, "shDegree": 0} for each in files))
    for name, file, found, part in zip(EXTRA, files, whole, parts, strict=True):
        _, error = EXTRA[name]
        assert found.get("error") == error, (name, found)
        assert (decoded(file) is None) == (error is not None), name
        assert "error" not in part, name
    most = decode_scene(data).float_bytes
    [few] = run({"bytes": files[0], "maxBytes": most + 4})
    [enough] = run({"bytes": files[0], "maxBytes": most + 5})
    assert (few.get("error"), enough.get("error")) == ("TooLargeError", None)
    for skipped in run(*({"bytes": each, "maxBytes": most, "extra": False} for each in files)):
        assert skipped["hash"] == enough["hash"]


def test_flipped_bits_of_extra_properties_are_detected_like_in_python():
    data = sample("m")
    at = data.index(b"label") - 3
    files = [with_checksums(flipped(data, bit)) for bit in range(8 * at, 8 * len(data), 5)]
    found = run(*({"bytes": each, "maxBytes": 1 << 20} for each in files))
    assert [each.get("hash") for each in found] == [decoded(each) for each in files]
    assert 0 < sum("error" in each for each in found) < len(found)
