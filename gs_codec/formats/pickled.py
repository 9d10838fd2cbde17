"""Read and write the pickles of PyTorch files without executing what they name.

A pickle is a program that may call any function. Here it can only build numbers, text, lists,
tuples, dictionaries, and tensors as descriptions of their storage; everything else that it names or
calls becomes `UNKNOWN`.
"""

from __future__ import annotations

import pickletools
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from gs_codec.errors import InvalidInput
from gs_codec.formats.limits import refusing

#: Integers with more bits become `UNKNOWN`: hashing them takes time, and Python may refuse to print
#: them.
_MOST_BITS = 64

#: Stands for everything in a pickle that is not one of the above.
UNKNOWN = object()

_TENSOR = "torch._utils _rebuild_tensor_v2"
_ORDERED = "collections OrderedDict"
_PARAMETERS = ("torch._utils _rebuild_parameter", "torch._utils _rebuild_parameter_with_state")


@dataclass(frozen=True)
class StoredTensor:
    """Location of the values of a tensor.

    Attributes
    ----------
    kind : str
        Class of the storage: ``torch FloatStorage``.
    key : str
        Name of the storage.
    length : int
        Number of values in the storage.
    offset : int
        Index of the tensor's first value.
    shape, strides : tuple of int
        Strides are in values.
    """

    kind: str
    key: str
    length: int
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    @property
    def used(self) -> tuple[int, int]:
        """Range of the storage's values that the tensor uses: first, and one past the last."""
        if 0 in self.shape:
            return 0, 0
        last = sum((n - 1) * stride for n, stride in zip(self.shape, self.strides, strict=False))
        return self.offset, self.offset + last + 1


@dataclass(frozen=True)
class _Global:
    name: str


@dataclass(frozen=True)
class _Storage:
    kind: str
    key: str
    length: int


def parse_pickle(data: bytes) -> Any:
    """The value of a pickle.

    Raises InvalidInput if it is damaged, or uses operations not found in PyTorch files.
    """
    machine = _Machine()
    with refusing("pickle"):
        for opcode, argument, _ in pickletools.genops(data):
            machine.step(opcode.name, argument)
        return machine.stack[-1]


class _Machine:
    """The stack of a pickle, the stacks below its marks, and its memo."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.below: list[list[Any]] = []
        self.kept: dict[int, Any] = {}

    def step(self, name: str, argument: Any) -> None:
        if name in _PUSHED:
            large = isinstance(argument, int) and argument.bit_length() > _MOST_BITS
            self.stack.append(UNKNOWN if large else argument)
        elif name in _MADE:
            self.stack.append(_MADE[name]())
        elif name in _SIZES:
            self.collect(_SIZES[name])
        elif name in _STEPS:
            _STEPS[name](self, argument)
        elif name not in ("PROTO", "FRAME", "STOP"):
            raise InvalidInput(f"pickle: opcode {name}, not expected in a checkpoint")

    def mark(self, _: Any) -> None:
        self.below.append(self.stack)
        self.stack = []

    def marked(self) -> list[Any]:
        """Pop everything above the last mark."""
        items, self.stack = self.stack, self.below.pop()
        return items

    def collect(self, size: int) -> None:
        """Combine the top `size` values of the stack into a tuple."""
        items = tuple(self.stack[-size:])
        del self.stack[-size:]
        self.stack.append(items)

    def keep(self, number: int | None) -> None:
        self.kept[len(self.kept) if number is None else number] = self.stack[-1]

    def extend(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], list):
            self.stack[-1].extend(items)

    def update(self, items: list[Any]) -> None:
        """Set items of a dictionary; other keys, slow to hash, are ignored."""
        if isinstance(self.stack[-1], dict):
            pairs = zip(items[::2], items[1::2], strict=True)
            self.stack[-1].update({k: v for k, v in pairs if isinstance(k, str | int)})

    def reduce(self, _: Any) -> None:
        arguments, called = self.stack.pop(), self.stack.pop()
        name = called.name if isinstance(called, _Global) else ""
        made: Any = UNKNOWN
        if name == _ORDERED:
            made = {}
        elif name in _PARAMETERS:
            made = arguments[0]
        elif name == _TENSOR and isinstance(arguments[0], _Storage):
            storage, offset, shape, strides = arguments[:4]
            made = _tensor(storage, offset, shape, strides)
        self.stack.append(made)

    def find(self, _: Any) -> None:
        """The storage described by ("storage", class, key, device, length)."""
        kind, known, key, _, length = self.stack.pop()
        if kind != "storage" or not isinstance(known, _Global) or not isinstance(key, str):
            raise InvalidInput("pickle: refers to something that is not a storage")
        self.stack.append(_Storage(known.name, key, _whole(length)))

    def name(self, _: Any) -> None:
        name, module = self.stack.pop(), self.stack.pop()
        known = isinstance(name, str) and isinstance(module, str)
        self.stack.append(_Global(f"{module} {name}" if known else ""))

    def make(self, _: Any) -> None:
        del self.stack[-2:]
        self.stack.append(UNKNOWN)


def _tensor(storage: _Storage, offset: Any, shape: Any, strides: Any) -> StoredTensor:
    sizes = tuple(map(_whole, shape)), tuple(map(_whole, strides))
    return StoredTensor(storage.kind, storage.key, storage.length, _whole(offset), *sizes)


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 40:
        # Without the value, because printing a tuple might take for ever.
        raise InvalidInput(f"pickle: {type(value).__name__}, expected a whole number below 2^40")
    return value


#: Opcodes by operation: push their argument, push something new, or push a tuple of values.
_PUSHED = {
    *("BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT", "SHORT_BINSTRING", "BINSTRING"),
    *("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "SHORT_BINBYTES", "BINBYTES", "BINBYTES8"),
}
_MADE: Mapping[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_TUPLE": tuple,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
    "EMPTY_SET": list,
}
_SIZES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_STEPS: Mapping[str, Callable[[_Machine, Any], None]] = {
    "MARK": _Machine.mark,
    "TUPLE": lambda machine, _: _push(machine, tuple),
    "LIST": lambda machine, _: _push(machine, list),
    "BINPUT": _Machine.keep,
    "LONG_BINPUT": _Machine.keep,
    "MEMOIZE": lambda machine, _: machine.keep(None),
    "BINGET": lambda machine, number: machine.stack.append(machine.kept[number]),
    "LONG_BINGET": lambda machine, number: machine.stack.append(machine.kept[number]),
    "APPEND": lambda machine, _: machine.extend([machine.stack.pop()]),
    "APPENDS": lambda machine, _: machine.extend(machine.marked()),
    "ADDITEMS": lambda machine, _: machine.extend(machine.marked()),
    "SETITEM": lambda machine, _: machine.update([machine.stack.pop(-2), machine.stack.pop()]),
    "SETITEMS": lambda machine, _: machine.update(machine.marked()),
    "GLOBAL": lambda machine, name: machine.stack.append(_Global(name)),
    "STACK_GLOBAL": _Machine.name,
    "BINPERSID": _Machine.find,
    "REDUCE": _Machine.reduce,
    "NEWOBJ": _Machine.make,
    # State besides a dictionary's items, such as versions of modules.
    "BUILD": lambda machine, _: machine.stack.pop(),
    "POP": lambda machine, _: machine.stack.pop(),
}


def _push(machine: _Machine, kind: Callable[[list[Any]], Any]) -> None:
    items = machine.marked()
    machine.stack.append(kind(items))


def write_pickle(value: Any) -> bytes:
    """The pickle of dictionaries of text, whole numbers and tensors, in PyTorch's form."""
    return b"\x80\x02" + _written(value) + b"."


def _written(value: Any) -> bytes:
    if isinstance(value, StoredTensor):
        return _written_tensor(value)
    if isinstance(value, dict):
        items = b"".join(_written(part) for item in value.items() for part in item)
        return b"}(" + items + b"u"
    if isinstance(value, tuple):
        return b"(" + b"".join(map(_written, value)) + b"t"
    if isinstance(value, str):
        text = value.encode()
        return b"X" + struct.pack("<I", len(text)) + text
    if isinstance(value, _Global):
        return b"c" + value.name.replace(" ", "\n").encode() + b"\n"
    return b"\x8a\x08" + value.to_bytes(8, "little", signed=True)


def _written_tensor(tensor: StoredTensor) -> bytes:
    storage = ("storage", _Global(tensor.kind), tensor.key, "cpu", tensor.length)
    numbers = b"".join(map(_written, (tensor.offset, tensor.shape, tensor.strides)))
    # No gradient required, and no backward hooks.
    rest = b"\x89" + _written(_Global(_ORDERED)) + b")R"
    return _written(_Global(_TENSOR)) + b"(" + _written(storage) + b"Q" + numbers + rest + b"tR"
