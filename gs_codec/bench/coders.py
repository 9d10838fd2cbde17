"""Entropy coders on the same symbols under the same tables, without the other stages."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.lattice_blocks import Block
from gs_codec.codec.lattice_encode import Modelled, code_blocks, model_lattice
from gs_codec.codec.symbols import Coded, quantise_scene
from gs_codec.config import LATTICE_PROFILES, Config
from gs_codec.container.file import MAX_BLOCK_SIZE, Section, SectionId
from gs_codec.entropy import constriction_coder, torchac_coder
from gs_codec.entropy.bits import BitReader
from gs_codec.entropy.passes import PassReader, PassTables
from gs_codec.entropy.rans import TableSet, decode_symbols, encode_symbols
from gs_codec.errors import MissingTool, ToolFailed
from gs_codec.lattice.tokens import read_pass
from gs_codec.model.table import shannon_bits
from gs_codec.report import StageTimes
from gs_codec.scene import Scene
from gs_codec.workers import run_all


def measure_coders(
    scene: Scene, name: str, config: Config, repeats: int
) -> Iterator[dict[str, Any]]:
    """A result line for each coder: bytes, bytes over Shannon entropy, seconds.

    Seconds are medians; torchac, which takes a hundred times longer than rANS, runs once. It and
    constriction are left out for profiles `l`, `m` and `s`, whose tables change with the context.
    """
    identity = {
        "kind": "coder",
        "scene": name,
        "profile": config.profile,
        "gaussians": scene.count,
    }
    if config.profile in LATTICE_PROFILES:
        yield identity | {"coder": "rans", **_passes(scene, config, repeats)}
        return
    coded = quantise_scene(scene, config)
    entropy = sum(shannon_bits(histogram) for histogram in coded.histograms) / 8
    identity["symbols"] = coded.symbols.size
    yield identity | {"coder": "rans", **_rans(coded, entropy, config.threads, repeats)}
    others: dict[str, Callable[[], dict[str, Any]]] = {
        "torchac": lambda: _torchac(coded, entropy),
        "constriction": lambda: _constriction(coded, entropy, repeats),
    }
    for coder, measure in others.items():
        try:
            theirs = measure()
        except MissingTool as error:
            theirs = {"absent": str(error)}
        yield identity | {"coder": coder, **theirs}


def _rans(coded: Coded, entropy: float, threads: int | None, repeats: int) -> dict[str, Any]:
    channels, count = coded.symbols.shape
    blocks = [(a, min(a + MAX_BLOCK_SIZE, count)) for a in range(0, count, MAX_BLOCK_SIZE)]

    def encode() -> list[tuple[bytes, bytes]]:
        tables = TableSet.pack(coded.tables)

        def work(block: tuple[int, int]) -> tuple[bytes, bytes]:
            states, words = encode_symbols(coded.symbols, *block, tables)
            return states, b"".join(words)

        return run_all(work, blocks, threads)

    def decode(streams: list[tuple[bytes, bytes]]) -> None:
        tables = TableSet.pack(coded.tables)

        def work(item: tuple[tuple[int, int], tuple[bytes, bytes]]) -> None:
            (start, stop), (states, words) = item
            groups = [(channels, memoryview(words))]
            decode_symbols(memoryview(states), groups, stop - start, tables, "bench")

        run_all(work, list(zip(blocks, streams, strict=True)), threads)

    streams = encode()
    decode(streams)
    size = sum(len(states) + len(words) for states, words in streams)
    return _result(
        size,
        entropy,
        statistics.median(_timed(encode)[1] for _ in range(repeats)),
        statistics.median(_timed(lambda: decode(streams))[1] for _ in range(repeats)),
    )


def _passes(scene: Scene, config: Config, repeats: int) -> dict[str, Any]:
    modelled = model_lattice(scene, config, None, StageTimes())

    def encode() -> list[list[Section]]:
        return code_blocks(modelled, config.threads)

    def decode(blocks: list[list[Section]]) -> None:
        tables = PassTables.pack(modelled.models.tables())
        items = list(zip(modelled.blocks, blocks, strict=True))
        run_all(lambda item: _read_block(modelled, tables, *item), items, config.threads)

    blocks = encode()
    decode(blocks)
    apart = (SectionId.GEOMETRY, SectionId.LOW_BITS)
    coded = [s for block in blocks for s in block if s.id not in apart]
    symbols = sum(data.tokens.size for block in modelled.blocks for data in block.passes)
    entropy = sum(cost.shannon_bits for cost in modelled.costs) / 8
    return {"symbols": symbols} | _result(
        sum(len(section.data) for section in coded),
        entropy,
        statistics.median(_timed(encode)[1] for _ in range(repeats)),
        statistics.median(_timed(lambda: decode(blocks))[1] for _ in range(repeats)),
    )


def _read_block(
    modelled: Modelled, tables: PassTables, block: Block, sections: list[Section]
) -> None:
    """Decode the passes of a block, their contexts being known."""
    by_id = {section.id: memoryview(section.data) for section in sections}
    reader = PassReader(by_id[SectionId.STATES], tables, "bench")
    places = np.arange(max(len(data.tokens) for data in block.passes))
    stream, bits = "", BitReader(memoryview(b""), "bench")
    for item, data, rows in zip(modelled.listed, block.passes, modelled.models.rows, strict=True):
        if item.stream != stream:
            stream, payload = item.stream, by_id[SectionId.of_stream(item.stream)]
            size = int.from_bytes(payload[:4], "little")
            reader.open(payload[4 : 4 + size])
            bits = BitReader(payload[4 + size :], "bench")
        values = np.empty(len(data.tokens), np.int32)
        read_pass(reader, bits, rows, data.contexts, places, values)
    reader.finish()


def _torchac(coded: Coded, entropy: float) -> dict[str, Any]:
    rows = list(zip(coded.symbols, coded.tables, strict=True))
    for symbols, table in rows[:1]:  # compiles, which is not what is timed
        torchac_coder.encode_symbols(symbols[:1], table)
    chunks, encode = _timed(lambda: [torchac_coder.encode_symbols(s, t) for s, t in rows])

    def decode() -> list[NDArray[np.uint16]]:
        return [
            torchac_coder.decode_symbols(channel, symbols.size, table)
            for channel, (symbols, table) in zip(chunks, rows, strict=True)
        ]

    decoded, seconds = _timed(decode)
    _check("torchac", decoded, coded)
    size = sum(len(part) for channel in chunks for part in channel)
    return _result(size, entropy, encode, seconds)


def _constriction(coded: Coded, entropy: float, repeats: int) -> dict[str, Any]:
    count = coded.symbols.shape[1]

    def encode() -> NDArray[np.uint32]:
        return constriction_coder.encode_symbols(coded.symbols, coded.tables)

    def decode() -> NDArray[np.uint16]:
        return constriction_coder.decode_symbols(words, count, coded.tables)

    words = encode()
    _check("constriction", decode(), coded)
    return _result(
        words.nbytes,
        entropy,
        statistics.median(_timed(encode)[1] for _ in range(repeats)),
        statistics.median(_timed(decode)[1] for _ in range(repeats)),
    )


def _check(coder: str, decoded: Iterable[NDArray[np.uint16]], coded: Coded) -> None:
    if not all(map(np.array_equal, decoded, coded.symbols)):
        raise ToolFailed(f"{coder} decodes other symbols than were coded")


def _result(size: int, entropy: float, encode: float, decode: float) -> dict[str, Any]:
    over = 100 * (size / entropy - 1) if entropy else 0.0
    return {
        "bytes": size,
        "overhead_percent": over,
        "encode_seconds": encode,
        "decode_seconds": decode,
    }


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start
