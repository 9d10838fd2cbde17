"""A stand-in for ``tmc3``: lossless, reorders points, and fails in the way TMC3_STAND_IN names.

``TMC3_STAND_IN=decode:count`` makes decoding lose a point. It implements none of G-PCC, only its
options and its input and output files.
"""

import os
import signal
import struct
import sys
import time
import zlib
from pathlib import Path

VERSION = "Stand-in for tmc3 version 0.1"
ROW_IN, ROW_OUT = struct.Struct("<3f3B"), struct.Struct("<3d3B")
IN_HEADER = """ply
format binary_little_endian 1.0
element vertex {}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""
OUT_HEADER = """ply
format binary_little_endian 1.0
element vertex {}
property float64 x
property float64 y
property float64 z
property uchar green
property uchar blue
property uchar red
element face 0
property list uint8 int32 vertex_index
end_header
"""


def encode(options):
    content = Path(options["--uncompressedDataPath"]).read_bytes()
    header, _, data = content.partition(b"end_header\n")
    count = int(header.split()[6])
    assert (header + b"end_header\n").decode() == IN_HEADER.format(count)
    assert len(data) == count * ROW_IN.size
    assert options["--mergeDuplicatedPoints"] == "0"
    # By colour, as if positions did not matter.
    rows = sorted(ROW_IN.iter_unpack(data), key=lambda row: row[::-1])
    packed = zlib.compress(b"".join(ROW_IN.pack(*row) for row in rows), 1)
    # One unit: its type (geometry), its size, its data.
    unit = b"\2" + len(packed).to_bytes(4, "big") + packed
    Path(options["--compressedStreamPath"]).write_bytes(unit)


def decode(options, failure):
    content = Path(options["--compressedStreamPath"]).read_bytes()
    assert content[:1] == b"\2"
    assert options["--outputBinaryPly"] == "1"
    rows = [list(row) for row in ROW_IN.iter_unpack(zlib.decompress(content[5:]))]
    if failure == "count":
        rows.pop()
    if failure == "values":
        rows[0][0] += 1 if rows[0][0] == 0 else -1
    out = b"".join(ROW_OUT.pack(*row[:3], row[4], row[5], row[3]) for row in rows)
    header = OUT_HEADER.format(len(rows)).encode()
    Path(options["--reconstructedDataPath"]).write_bytes(header + out)


def fail(failure, output):
    """All failures that do not need to look at the input."""
    if failure == "exit":
        print("the first line\n  Error: no \x1b[31mgood\n", file=sys.stderr)
        sys.exit(3)
    if failure == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    if failure == "hang":
        time.sleep(1e5)
    if failure == "spin":
        while True:
            pass
    if failure == "memory":
        bytearray(1 << 30)
    if failure == "huge":
        with open(output, "wb") as file:
            while True:
                file.write(bytes(1 << 20))
    if failure == "garbage":
        Path(output).write_bytes(b"\xff" * 1000)
        sys.exit(0)
    if failure == "empty":
        Path(output).write_bytes(b"")
        sys.exit(0)
    if failure == "nothing":
        sys.exit(0)


def main():
    way, _, failure = os.environ.get("TMC3_STAND_IN", "").partition(":")
    if sys.argv[1:] == ["--help"]:
        lines = {"": VERSION, "silent": "", "other": "usage: other"}
        print(lines[failure if way == "help" else ""], "\n  --mode=0   0: encode, 1: decode")
        return
    options = dict(argument.split("=") for argument in sys.argv[1:])
    encoding = options["--mode"] == "0"
    failure = failure if way == ("encode" if encoding else "decode") else ""
    fail(failure, options["--compressedStreamPath" if encoding else "--reconstructedDataPath"])
    if encoding:
        encode(options)
    else:
        decode(options, failure)


if __name__ == "__main__":
    main()
