"""Minimal writers of other formats, from their specifications."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.recfunctions import repack_fields

from gs_codec.scene import DEGREE_4, SH_COEFFICIENTS

SH_C0 = 0.28209479177387814

PACKED_BOUNDS = [f"{end}_{axis}" for axis in "xyz" for end in ("min", "max")]
PACKED_BOUNDS += [f"{end}_scale_{axis}" for axis in "xyz" for end in ("min", "max")]
PACKED_COLOURS = [f"{end}_{axis}" for axis in "rgb" for end in ("min", "max")]


def ply_file(elements: list[tuple[str, np.ndarray]], lines: str = "", end: str = "<") -> bytes:
    """A binary PLY of elements, written by hand."""
    codes = {"f4": "float", "f8": "double", "i1": "char", "u1": "uchar", "u2": "ushort"}
    codes |= {"i4": "int", "u4": "uint"}
    form = {"<": "little", ">": "big"}[end]
    header = f"ply\nformat binary_{form}_endian 1.0\n{lines}"
    body = b""
    for name, rows in elements:
        rows = repack_fields(rows)
        header += f"element {name} {len(rows)}\n"
        for key in rows.dtype.names or ():
            header += f"property {codes[rows.dtype[key].str[1:]]} {key}\n"
        body += rows.astype(rows.dtype.newbyteorder(end)).tobytes()
    return header.encode() + b"end_header\n" + body


def packed_rows(count: int, seed: int, degree: int = 0) -> dict[str, np.ndarray]:
    """Elements of a packed PLY, with random bits."""
    rng = np.random.default_rng(seed)
    chunks = -(-count // 256)
    limits = np.sort(rng.normal(size=(chunks, 9, 2)).astype("<f4"), axis=2).reshape(chunks, 18)
    chunk = np.zeros(chunks, [(name, "<f4") for name in PACKED_BOUNDS + PACKED_COLOURS])
    for i, name in enumerate(chunk.dtype.names or ()):
        chunk[name] = limits[:, i]
    names = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
    vertex = np.zeros(count, [(name, "<u4") for name in names])
    for name in names:
        vertex[name] = rng.integers(0, 1 << 32, count, dtype=np.uint64)
    elements = {"chunk": chunk, "vertex": vertex}
    if degree:
        sh = np.zeros(count, [(f"f_rest_{i}", "u1") for i in range(3 * SH_COEFFICIENTS[degree])])
        for name in sh.dtype.names or ():
            sh[name] = rng.integers(0, 256, count)
        elements["sh"] = sh
    return elements


def spz_streams(count: int, version: int, degree: int, seed: int) -> list[bytes]:
    """Attributes of an `.spz` file, with random bits; version 1 has finite halves."""
    rng = np.random.default_rng(seed)
    coefficients = (*SH_COEFFICIENTS, DEGREE_4)[degree]
    sizes = [9, 1, 3, 3, 3 if version < 3 else 4, 3 * coefficients]
    streams = [rng.bytes(size * count) for size in sizes]
    if version == 1:
        streams[0] = rng.normal(size=(count, 3)).astype("<f2").tobytes()
    return streams


def spz_file(
    streams: list[bytes],
    count: int,
    version: int,
    degree: int,
    flags: int = 0,
    bits: int = 12,
    extensions: bytes = b"",
    zipped: bool = True,
) -> bytes:
    """An `.spz` file from its attributes and extensions."""
    fields = (b"NGSP", version, count, degree, bits, flags)
    if version < 4:
        data = struct.pack("<4sIIBBBB", *fields, 0) + b"".join(streams) + extensions
        return gzip.compress(data, mtime=0) if zipped else data
    import zstandard

    kept = [stream for stream in streams if stream]
    packed = [zstandard.ZstdCompressor().compress(stream) for stream in kept]
    header = struct.pack("<4sIIBBBBI12x", *fields, len(kept), 32 + len(extensions))
    table = b"".join(struct.pack("<QQ", len(a), len(b)) for a, b in zip(packed, kept, strict=True))
    return header + extensions + table + b"".join(packed)


def splat_rows(count: int, seed: int) -> np.ndarray:
    """Records of a `.splat` file."""
    rng = np.random.default_rng(seed)
    dtype = [("p", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("r", "u1", 4)]
    rows = np.zeros(count, dtype)
    rows["p"] = rng.normal(size=(count, 3))
    rows["s"] = np.exp(rng.normal(-4, 1, size=(count, 3)))
    rows["c"] = rng.integers(0, 256, (count, 4))
    rows["r"] = rng.integers(0, 256, (count, 4))
    return rows


KSPLAT_BOUNDS = (-0.75, 1.25)


def ksplat_rows(count: int, level: int, degree: int, seed: int) -> np.ndarray:
    """Rows of a section of a `.ksplat` file."""
    rng = np.random.default_rng(seed)
    centre, shape, sh = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
    channels = 3 * SH_COEFFICIENTS[degree]
    dtype = [("p", centre, 3), ("s", shape, 3), ("r", shape, 4), ("c", "u1", 4)]
    rows = np.zeros(count, [*dtype, ("h", sh, (channels,))])
    rows["p"] = rng.integers(0, 65536, (count, 3)) if level else rng.normal(size=(count, 3))
    rows["s"] = np.exp(rng.normal(-4, 1, size=(count, 3)))
    rows["r"] = rng.normal(size=(count, 4))
    rows["c"] = rng.integers(0, 256, (count, 4))
    shape_of_sh = (count, channels)
    rows["h"] = rng.integers(0, 256, shape_of_sh) if level == 2 else rng.normal(size=shape_of_sh)
    return rows


def ksplat_file(
    level: int,
    sections: list[tuple[int, np.ndarray, int, list[int], np.ndarray]],
    /,
    **changes: int,
) -> bytes:
    """A `.ksplat` file of sections; `changes` override header values.

    A section has: SH degree, rows, size of full buckets, lengths of the others, and the middles of
    all buckets, which are 4 wide.
    """
    total = sum(len(rows) for _, rows, *_ in sections)
    known = {"minor": 1, "number": len(sections), "count": total, "level": level} | changes
    head = struct.pack("<BBxx4IHxx", 0, known["minor"], known["number"], known["number"],
                       known["count"], known["count"], known["level"])  # fmt: skip
    head += struct.pack("<3f2f", 0, 0, 0, *KSPLAT_BOUNDS)
    heads, bodies = head.ljust(4096, b"\0"), b""
    for degree, rows, size, lengths, middles in sections:
        buckets = len(middles) if level else 0
        others = len(lengths) if level else 0
        body = np.array(lengths if level else [], "<u4").tobytes()
        body += middles.astype("<f4").tobytes() if level else b""
        body += rows.tobytes()
        values = (len(rows), len(rows), size, buckets, 4.0, 12 if level else 0, 0, len(body))
        heads += struct.pack("<4IfHxx4IH", *values, buckets - others, others, degree).ljust(
            1024, b"\0"
        )
        bodies += body
    return heads + bodies


def webp(pixels: np.ndarray) -> bytes:
    """A lossless image of pixels ``(H, W, 4)``."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8), "RGBA").save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def png(pixels: np.ndarray) -> bytes:
    """The same as PNG."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8), "RGBA").save(out, "PNG")
    return out.getvalue()


def sog_parts(
    count: int, version: int, degree: int, seed: int, palette: int = 70
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """`meta.json` and image pixels of a SOG scene, with random values."""
    rng = np.random.default_rng(seed)
    side = 4 * -(-max(count, 1) // 16)
    names = ["means_l", "means_u", "quats", "scales", "sh0"]
    images = {f"{name}.webp": rng.integers(0, 256, (side, 4, 4)) for name in names}
    images["quats.webp"][..., 3] = rng.integers(252, 256, (side, 4))
    meta: dict[str, Any] = {
        "means": {
            "mins": [-1.5, -1, -2],
            "maxs": [1, 2.5, 3],
            "files": names_of("means_l means_u"),
        },
        "scales": {"files": names_of("scales")},
        "quats": {"files": names_of("quats")},
        "sh0": {"files": names_of("sh0")},
    }
    if degree:
        coefficients = SH_COEFFICIENTS[degree]
        labels = rng.integers(0, 256, (side, 4, 4))
        rows = rng.integers(0, palette, (side, 4))
        labels[..., 0], labels[..., 1] = rows & 255, rows >> 8
        height = -(-palette // 64)
        images["shN_labels.webp"] = labels
        images["shN_centroids.webp"] = rng.integers(0, 256, (height, 64 * coefficients, 4))
        meta["shN"] = {"files": names_of("shN_centroids shN_labels")}
    if version == 2:
        meta |= {"version": 2, "count": count}
        for name in ("scales", "sh0", "shN"):
            if name in meta:
                meta[name]["codebook"] = np.sort(rng.normal(size=256)).tolist()
        if degree:
            meta["shN"] |= {"count": palette, "bands": degree}
    else:
        meta["means"]["shape"] = [count, 3]
        meta["scales"] |= {"mins": [-9, -8, -7], "maxs": [0, 1, 2]}
        meta["sh0"] |= {"mins": [-2, -1, -2, -5], "maxs": [2, 3, 1, 9]}
        if degree:
            meta["shN"] |= {"mins": -0.5, "maxs": 0.75}
    return meta, images


def names_of(stems: str) -> list[str]:
    return [f"{stem}.webp" for stem in stems.split()]


def sog_file(meta: dict[str, Any], images: dict[str, np.ndarray], folder: str = "") -> bytes:
    """A SOG scene as one zip."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr(folder + "meta.json", json.dumps(meta))
        for name, pixels in images.items():
            archive.writestr(folder + name, webp(pixels))
    return out.getvalue()


def sog_folder(folder: Path, meta: dict[str, Any], images: dict[str, np.ndarray]) -> Path:
    """A SOG scene as files in a folder; returns the path of `meta.json`."""
    for name, pixels in images.items():
        (folder / name).write_bytes(webp(pixels))
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder / "meta.json"


#: Values of each property of a `.rad` per Gaussian, and an encoding that keeps all floats.
RAD_PROPERTIES = {
    "center": (3, "f32_lebytes"),
    "alpha": (1, "f32"),
    "rgb": (3, "f32"),
    "scales": (3, "f32"),
    "orientation": (3, "f32"),
    "sh1": (9, "f32"),
    "sh2": (15, "f32"),
    "sh3": (21, "f32"),
    "child_count": (1, "u16"),
    "child_start": (1, "u32"),
    "sh_label": (1, "u16"),
}


def rad_bytes(encoding: str, values: np.ndarray, low: float = 0, high: float = 1) -> bytes:
    """Values ``(rows, N)`` in an encoding of a `.rad`, as in Spark's `rad.rs`."""
    if encoding == "oct88r8":
        return rad_rotations(values)
    if encoding.startswith("r8"):
        values = np.rint(np.clip((values - low) / (high - low), 0, 1) * 255).astype("u1")
    if encoding.startswith("s8"):
        values = np.rint(np.clip(values / high, -1, 1) * 127).astype("i1").view("u1")
    if encoding.startswith("ln"):
        values = np.log(values)
    if encoding == "ln_0r8":
        levels = np.rint(np.clip((values - low) / (high - low), 0, 1) * 254) + 1
        values = np.where(values <= -30, 0, levels).astype("u1")
    if encoding.endswith("delta"):
        values = np.diff(values, axis=1, prepend=np.zeros_like(values[:, :1]))
    if encoding.endswith("lebytes"):
        planes = values.astype(f"<f{int(encoding[1:3]) // 8}")
        return np.moveaxis(planes[..., None].view("u1"), 2, 0).tobytes()
    kind = {"f32": "<f4", "f16": "<f2", "ln_f16": "<f2", "u16": "<u2", "u32": "<u4"}
    return values.astype(kind.get(encoding, "u1")).tobytes()


def rad_rotations(xyz: np.ndarray) -> bytes:
    """Rotations as an axis on an octahedron and an angle, from the first three components."""
    sine = np.sqrt((xyz * xyz).sum(axis=0))
    axis = xyz / np.abs(xyz).sum(axis=0)
    folded = (1 - np.abs(axis[1::-1])) * np.where(axis[:2] >= 0, 1, -1)
    u, v = np.where(axis[2] < 0, folded, axis[:2]) / 2 + 0.5
    angle = 2 * np.arccos(np.sqrt(1 - sine**2)) / np.pi
    return np.rint(255 * np.stack([u, v, angle], axis=1)).astype("u1").tobytes()


def rad_described(magic: bytes, about: Any) -> bytes:
    """A description of a `.rad`: anything for JSON, or its bytes."""
    text = about if isinstance(about, bytes) else json.dumps(about).encode()
    return magic + struct.pack("<I", len(text)) + text + bytes(-len(text) % 8)


def rad_chunk(
    values: dict[str, np.ndarray], encodings: dict[str, str], bounds: tuple[float, float] = (0, 1)
) -> tuple[dict[str, Any], bytes]:
    """The description and the data of a chunk, from ``(rows, N)`` of each property."""
    payload, properties = b"", []
    for name, rows in values.items():
        encoding = encodings.get(name) or RAD_PROPERTIES[name.removesuffix("_code")][1]
        packer = zlib.compressobj(6, zlib.DEFLATED, -15)
        data = packer.compress(rad_bytes(encoding, rows, *bounds)) + packer.flush()
        about = {"property": name, "encoding": encoding, "compression": "gz"}
        where = {"offset": len(payload), "bytes": len(data)}
        properties.append(about | where | {"min": bounds[0], "max": bounds[1]})
        payload += data + bytes(-len(data) % 8)
    degree = sum(f"sh{band}" in values or f"sh{band}_code" in values for band in (1, 2, 3))
    about = {"version": 1, "base": 0, "count": values["alpha"].shape[1], "maxSh": degree}
    return about | {"payloadBytes": len(payload), "properties": properties}, payload


def rad_file(
    chunks: list[tuple[Any, bytes]], /, prefix: str | None = None, **changes: Any
) -> dict[str, bytes]:
    """A `.rad` file under the name "", and its `.radc` files if their names have a `prefix`.

    `changes` override the description.
    """
    parts = [
        rad_described(b"RADC", each) + struct.pack("<Q", len(data)) + data for each, data in chunks
    ]
    others = {} if prefix is None else {f"{prefix}{i}.radc": part for i, part in enumerate(parts)}
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    if "count" not in changes:
        degree, counts = chunks[0][0]["maxSh"], [each["count"] for each, _ in chunks]
        changes = {"count": sum(counts), "maxSh": degree} | changes
    about = {
        "version": 1,
        "type": "gsplat",
        "lodTree": True,
        "chunks": [{"offset": 0, "filename": name} for name in others]
        or [{"offset": a, "bytes": len(p)} for a, p in zip(starts, parts, strict=False)],
    }
    body = b"" if others else b"".join(parts)
    return {"": rad_described(b"RAD0", about | changes) + body, **others}


def rad_values(count: int, degree: int, seed: int, levels: bool = False) -> dict[str, np.ndarray]:
    """Values of Gaussians for a chunk; with `levels`, the first is the root of all others."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(3, count))
    values = {
        "center": rng.normal(size=(3, count)),
        "alpha": rng.uniform(0.1, 0.9, (1, count)),
        "rgb": rng.uniform(0, 1, (3, count)),
        "scales": np.exp(rng.normal(-4, 1, (3, count))),
        "orientation": 0.9 * xyz / np.sqrt((xyz * xyz).sum(axis=0)),
    }
    for band in range(1, degree + 1):
        values[f"sh{band}"] = rng.uniform(-0.4, 0.4, (6 * band + 3, count))
    if levels:
        only = np.arange(count)[None] == 0
        values |= {"child_count": (count - 1) * only, "child_start": 1 * only}
    return values


def lcc_files(kind: str | None) -> tuple[dict[str, bytes], list[np.ndarray], list[np.ndarray]]:
    """Files of an `.lcc` with two cells and two levels, random bits.

    Also the rows and SH-AC of the finest level, and of the environment.
    """
    rng = np.random.default_rng(3)
    dtype = [("p", "<f4", 3), ("c", "u1", 4), ("s", "<u2", 3), ("r", "<u4"), ("n", "<u2", 3)]
    rows = np.frombuffer(rng.bytes(12 * 32), dtype).copy()
    rows["p"] = rng.normal(size=(12, 3))
    sh = rng.integers(0, 1 << 32, (12, 16), np.uint32)
    # The finest levels are rows 0 to 2 and 3 to 6; the others 7 to 8 and 9.
    cells = ((0, 0, 3, 0, 96, 2, 224, 64), (1, -1, 4, 96, 128, 1, 288, 32))
    bounds = {"scale": (1e-3, 0.5), "shcoef": (-1, 1), "envscale": (1e-3, 0.5)}
    bounds |= {"envshcoef": (-0.5, 0.5)}
    about = {
        "totalLevel": 2,
        "splats": [7, 3],
        "attributes": [
            {"name": name, "min": 3 * [low], "max": 3 * [high]}
            for name, (low, high) in bounds.items()
        ],
    }
    if kind:
        about["fileType"] = kind
    has_sh = kind != "Portable"
    distant = [
        row.tobytes() + (own.tobytes() if has_sh else b"")
        for row, own in zip(rows[10:], sh[10:], strict=True)
    ]
    files = {
        "a.lcc": json.dumps(about).encode(),
        "index.bin": b"".join(struct.pack("<2hiqiiqi", *cell) for cell in cells),
        "data.bin": rows[:10].tobytes(),
        **({"shcoef.bin": sh[:10].tobytes()} if has_sh else {}),
        "environment.bin": b"".join(distant),
    }
    return files, [rows[:7], rows[10:]], [sh[:7], sh[10:]]


def lcc2_files(names: list[str], earlier: bool = False) -> dict[str, bytes]:
    """An `.lcc2` of four files: two of the finest level, a coarser one, and the environment."""

    def node(index: int, *children: dict) -> dict:
        return {"data": {"3dgs": {"name": index}}, "child": list(children)}

    tree = {"0": node(2, node(0), node(1), node(1))}
    root: dict[str, Any] = {"data": {"env": {"name": 3}}, "child": tree}
    about: dict[str, Any] = {"root": root}
    if earlier:
        root["files"] = [f"/{name.removesuffix('.sog')}" for name in names]
        about |= {"total_splats": 1, "lod_3dgs_info": [1, 2], "lod_level": 2}
    else:
        root["splatFiles"] = names
        about |= {"totalSplats": 1, "lodSplats": [2, 1], "totalLevels": 2, "splatType": ".sog"}
    return {"a.lcc2": json.dumps(about).encode()}
