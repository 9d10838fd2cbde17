"""Precompiled kernels that come with the package, for common processors.

`kernel_build` writes an archive for each of `TIERS`, and `load` searches those that match this
Python, numba and processor. Kernels with edited sources are not found.
"""

from __future__ import annotations

import functools
import hashlib
import json
import mmap
import pickle
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core import config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.runtime import nrtdynmod, rtsys

from gs_codec.errors import one_line
from gs_codec.runtime.kernel_cache import settings, stamp
from gs_codec.runtime.kernel_list import entry_of

#: Folder of archives in an installed package.
FOLDER = Path(__file__).with_name("compiled")

_MAGIC = b"gs_codec kernels 1\n"
_DIGEST_BYTES = 32

#: Name of the machine code of numba's runtime, which numba otherwise compiles in each process.
_RUNTIME = "numba runtime"

_V3 = (
    "64bit", "avx", "avx2", "bmi", "bmi2", "cmov", "crc32", "cx16", "cx8", "f16c", "fma", "fxsr",
    "lzcnt", "mmx", "movbe", "popcnt", "sahf", "sse", "sse2", "sse3", "sse4.1", "sse4.2", "ssse3",
    "xsave",
)  # fmt: skip

#: Processors to compile for, the best first: name, and features in LLVM's notation. x86-64-v4 would
#: halve the vector length, because its first processors were slow with long vectors.
TIERS = {
    "x86-64-v4": ("znver4", (*_V3, "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")),
    "x86-64-v3": ("x86-64-v3", _V3),
}


def target_of(tier: str) -> tuple[str, str]:
    """Values of NUMBA_CPU_NAME and NUMBA_CPU_FEATURES for a tier."""
    name, features = TIERS[tier]
    signed = ("+-"[each not in features] + each for each in llvm.get_host_cpu_features())
    return name, ",".join(signed)


def _made_for() -> dict[str, str]:
    """What an archive depends on besides the processor."""
    return {
        "Python": sys.implementation.cache_tag + getattr(sys, "abiflags", ""),
        "numba": numba.__version__,
        "system": llvm.get_process_triple(),
        "settings": " ".join(settings()),
    }


class Archive:
    """An archive that has been read.

    Raises ValueError if it is damaged, or was made for something else.

    Parameters
    ----------
    content : bytes-like
        Content of the file after the magic number.
    """

    def __init__(self, content: Any) -> None:
        begin = _DIGEST_BYTES
        size = int.from_bytes(content[begin : begin + 8], "little")
        index, self._parts = content[begin + 8 : begin + 8 + size], content[begin + 8 + size :]
        if content[:begin] != hashlib.sha256(index).digest():
            raise ValueError("are damaged")
        head = json.loads(bytes(index))
        if len(self._parts) != head["bytes"]:
            raise ValueError("are truncated")
        for name, wanted in head["made for"].items():
            if wanted != _made_for()[name]:
                found = _made_for()[name]
                raise ValueError(f"are made for {name} {wanted}, not {found}")
        self.stamps: dict[str, str] = {name: each[0] for name, each in head["kernels"].items()}
        self._places = {name: each[1:] for name, each in head["kernels"].items()}

    def part(self, name: str) -> Any:
        """The entry under a name; None if it is missing or damaged."""
        begin, end, digest = self._places.get(name, (0, 0, ""))
        part = self._parts[begin:end]
        intact = hashlib.sha256(part).hexdigest() == digest
        return pickle.loads(part) if intact else None


@functools.cache
def _found() -> tuple[list[Archive], list[str]]:
    """The archives for this machine, the best first, and the reasons why others do not apply."""
    archives, reasons = [], []
    paths = {tier: FOLDER / f"{tier}.kernels" for tier in TIERS}
    for tier, path in paths.items():
        try:
            with open(path, "rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise ValueError("are damaged")
                content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            archive = Archive(memoryview(content)[len(_MAGIC) :])
            _check_processor(tier)
            archives.append(archive)
        except FileNotFoundError:
            continue
        except (OSError, ValueError, KeyError, TypeError) as error:
            reasons.append(f"those that come with it {one_line(error)}")
    return archives, reasons


def _check_processor(tier: str) -> None:
    """Check that this processor belongs to a tier, and that no other is configured."""
    present = llvm.get_host_cpu_features()
    if not all(present.get(each) for each in TIERS[tier][1]):
        raise ValueError(f"need a processor with {tier}")
    if config.CPU_NAME is not None or config.CPU_FEATURES is not None:
        raise ValueError("are not for NUMBA_CPU_NAME")


def why_not() -> str:
    """Why archives are not used; empty if there are none, or if one is used."""
    archives, reasons = _found()
    return "" if archives or not reasons else reasons[-1]


def load(function: Callable, types: Any, target: Any) -> CompileResult | None:
    """Load a kernel for these types; None if it must be compiled."""
    name = " ".join(entry_of(function, types))
    for archive in _found()[0]:
        stamped = archive.stamps.get(name)
        if stamped and stamped == stamp_text(function) and (part := archive.part(name)):
            return _Opened.result(part, target)
    return None


def stamp_text(function: Callable) -> str:
    """Digest of the sources of a kernel."""
    return hashlib.sha256(repr(stamp(function)).encode()).hexdigest()


class _Opened:
    """numba's target for an archive: its libraries are `_Library`."""

    def __init__(self, target: Any) -> None:
        self._target = target

    @classmethod
    def result(cls, part: Any, target: Any) -> CompileResult:
        target.refresh()
        return CompileResult._rebuild(cls(target), *part)

    def codegen(self) -> Any:
        return self

    def unserialize_library(self, parts: Any) -> _Library:
        return _Library.opened(self._target.codegen(), *parts)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)


class _Library(JITCodeLibrary):
    """Machine code; its LLVM module is parsed only when a kernel that calls it is compiled."""

    _bitcode: bytes | None = None
    _module: Any = None

    @classmethod
    def opened(
        cls, codegen: Any, name: str, code: bytes, bitcode: bytes, symbols: set[str]
    ) -> _Library:
        """Create a library of machine code that is ready to call; `symbols` are those defined."""
        library = cls(codegen, name)
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._bitcode = bitcode
        library._finalize_final_module()
        codegen._engine._defined_symbols |= symbols
        return library

    @property
    def _shared_module(self) -> Any:
        if self._module is None and self._bitcode is not None:
            self._module = llvm.parse_bitcode(zlib.decompress(self._bitcode))
        return self._module

    @_shared_module.setter
    def _shared_module(self, module: Any) -> None:
        self._module = module


def begin_runtime(target: Any) -> None:
    """Set up numba's runtime, from the machine code of an archive if there is one."""
    if rtsys._init:
        return
    compile_runtime = nrtdynmod.compile_nrt_functions
    part = next(filter(None, (archive.part(_RUNTIME) for archive in _found()[0])), None)
    if part is not None:
        nrtdynmod.compile_nrt_functions = lambda context: _Library.opened(context.codegen(), *part)
    try:
        rtsys.initialize(target)
    finally:
        nrtdynmod.compile_nrt_functions = compile_runtime


def keep_runtime() -> None:
    """Make numba keep the machine code of its runtime; call before it is set up."""

    def compile_runtime(context: Any) -> Any:
        module, library = nrtdynmod.create_nrt_module(context)
        library.enable_object_caching()
        library.add_ir_module(module)
        library.finalize()
        return library

    nrtdynmod.compile_nrt_functions = compile_runtime


def write(path: Path, kernels: list[tuple[Any, Any]], runtime: bool) -> None:
    """Write an archive of kernels, each for some types, that this process has compiled."""
    from numba.core.serialize import dumps

    places: dict[str, tuple[Any, ...]] = {}
    content = bytearray()

    def add(name: str, stamp: str, part: Any) -> None:
        data, begin = dumps(part), len(content)
        content.extend(data)
        places[name] = stamp, begin, len(content), hashlib.sha256(data).hexdigest()

    for kernel, types in kernels:
        result = kernel.overloads[types]
        _, *rest = result._reduce()
        rest[5] = ""  # type annotations, with paths
        function = kernel.py_func
        name = " ".join(entry_of(function, types))
        add(name, stamp_text(function), (_parts(result.library), *rest))
    if runtime:
        add(_RUNTIME, "", _parts(rtsys.library))
    head = {"made for": _made_for(), "bytes": len(content), "kernels": places}
    index = json.dumps(head).encode()
    digest, size = hashlib.sha256(index).digest(), len(index).to_bytes(8, "little")
    path.write_bytes(b"".join((_MAGIC, digest, size, index, content)))


def _parts(library: Any) -> tuple[str, bytes, bytes, set[str]]:
    """The arguments of `_Library.opened`."""
    name, _, (code, bitcode) = library.serialize_using_object_code()
    module = library._get_module_for_linking()
    known = (*module.functions, *module.global_variables)
    symbols = {each.name for each in known if not each.is_declaration}
    return name, code, zlib.compress(bitcode, 9), symbols
