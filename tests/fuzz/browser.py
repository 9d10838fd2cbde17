"""Compare the JavaScript decoder with Python's: both reject a file, or return the same floats."""

from __future__ import annotations

import hashlib
import json
import select
import shutil
import struct
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
from damage import ENTRY, HEADER, SECTIONS, with_checksums

from gs_codec.codecs import decode_part
from gs_codec.codecs.part import Part
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.egs.index import levels_of
from gs_codec.errors import GsCodecError
from gs_codec.scene import GROUPS, Scene

HERE = Path(__file__).parent
NODE = shutil.which("node")

#: Maximum bytes of a decoded scene; maximum MiB of Node; seconds per file.
MOST, MEMORY, SECONDS = 1 << 22, 600, 20

#: Features that only the Python decoder supports.
_NOT_READ = ("profile lossless", "G-PCC", "torchac")


@cache
def _node() -> subprocess.Popen[bytes]:
    command = [str(NODE), str(HERE.parent / "web" / "decode_each.mjs"), str(MOST)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def _by_node(data: bytes) -> dict:
    node = _node()
    assert node.stdin
    assert node.stdout
    node.stdin.write(struct.pack("<I", len(data)) + data)
    node.stdin.flush()
    if not select.select([node.stdout], [], [], SECONDS)[0]:
        node.kill()
        raise AssertionError(f"no answer in {SECONDS} seconds")
    found = json.loads(node.stdout.readline())
    assert found["peak"] < MEMORY, f"{found['peak']} MiB"
    return found


def _digest(scene: Scene) -> str:
    planes = [np.ascontiguousarray(getattr(scene, group), "<f4") for group in GROUPS]
    return hashlib.sha256(b"".join(plane.tobytes() for plane in planes)).hexdigest()


def _whole(data: bytes) -> dict | None:
    try:
        scene = decode_part(data, Part(), 1, MOST)[0]
    except GsCodecError:
        return None
    facts = [scene.count, scene.sh_degree, scene.coordinates, scene.antialiased]
    return {"digest": _digest(scene), "facts": facts}


def _levels(data: bytes) -> dict | None:
    try:
        numbers = levels_of(read_file(data, lambda *_: False))
        parts = [decode_part(data, Part(level=level), 1, MOST)[0] for level in numbers]
    except GsCodecError:
        return None
    return {"digests": [_digest(scene) for scene in parts]}


def compare(data: bytes) -> None:
    """Decode a file with both; its first byte says whether checksums are corrected first."""
    if not data:
        return
    stream = _with_all_checksums(data[1:]) if data[0] & 1 else data[1:]
    found = _by_node(stream)
    if any(text in found["scene"].get("message", "") for text in _NOT_READ):
        return
    _check(found["scene"], _whole(stream), stream)
    if not found["levels"].get("skipped") and "error" not in found["scene"]:
        _check(found["levels"], _levels(stream), stream)


def _check(found: dict, expected: dict | None, stream: bytes) -> None:
    if "error" in found:
        kinds = ("CorruptError", "UnsupportedError", "TooLargeError")
        assert found["error"] in kinds, found
        assert "\n" not in found["message"], found
        assert expected is None, found
    elif expected is None:
        # The JavaScript decoder ignores extra properties, so it does not reject them.
        assert any(section == SectionId.EXTRA for section, *_ in _sections(stream)), found
    else:
        assert found == expected


def _sections(data: bytes) -> list[tuple[int, int, int]]:
    """Identifier, position and size of the sections listed in a header, if it can be parsed."""
    if len(data) < HEADER:
        return []
    count = min(struct.unpack_from("<I", data, SECTIONS)[0], (len(data) - HEADER) // ENTRY)
    position = HEADER + ENTRY * count + 4
    found = []
    for entry in range(HEADER, HEADER + ENTRY * count, ENTRY):
        size = struct.unpack_from("<Q", data, entry + 8)[0]
        found.append((struct.unpack_from("<H", data, entry)[0], position, size))
        position += -(-size // 4) * 4
    return found


def _with_all_checksums(data: bytes) -> bytes:
    """The file with all checksums corrected, including those of its levels."""
    stream = bytearray(data)
    for section, position, size in _sections(data):
        if section == SectionId.LEVEL and HEADER < size <= len(data) - position:
            stream[position : position + size] = with_checksums(data[position : position + size])
    return with_checksums(stream) if len(stream) > HEADER else bytes(stream)
