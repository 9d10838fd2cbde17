"""Headers of PLY files: elements, their properties, and the start of the body."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from dataclasses import dataclass, field

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.runtime.mapped import FileBytes

#: Maximum bytes of a header. `.egs` files keep up to 2^20 bytes of comments; PLY adds a word to
#: each line.
_HEADER_BYTES = 1 << 24

#: Bytes read first; a trainer's header has 1,500.
_FIRST_BYTES = 1 << 16

_PROPERTIES = 1 << 16

#: Maximum number of elements; animations of Brush have three for each frame.
_ELEMENTS = 1 << 16

_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CODES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
_TYPES = {name: code for code, names in _CODES.items() for name in names}
_PLAIN = re.compile(r"[ -~\t]*")
_COUNT = re.compile(r"\d{1,18}", re.ASCII)


@dataclass
class Element:
    """An element of a PLY file.

    Attributes
    ----------
    name : str
    count : int
        Number of rows, from the header.
    types : dict of str to str
        NumPy's code of each scalar property, without byte order.
    lists : dict of str to str
        NumPy's code of the items of each list property.
    """

    name: str
    count: int
    types: dict[str, str] = field(default_factory=dict)
    lists: dict[str, str] = field(default_factory=dict)

    def dtype(self, byte_order: str) -> np.dtype:
        """Type of a row in a binary file."""
        return np.dtype([(name, byte_order + code) for name, code in self.types.items()])


@dataclass
class PlyHeader:
    """Contents of a PLY header.

    Attributes
    ----------
    byte_order : {"<", ">", ""}
        Empty in a text file.
    elements : dict of str to Element
        By name, in the order of the file.
    comments : tuple of str
        Comments of printable ASCII and tabs.
    odd_comments : int
        Number of other comments.
    obj_info : int
        Number of ``obj_info`` lines.
    size : int
        Bytes of the header.
    """

    byte_order: str
    elements: dict[str, Element]
    comments: tuple[str, ...]
    odd_comments: int
    obj_info: int
    size: int


def read_header(data: memoryview | FileBytes) -> PlyHeader:
    """Read the header of a PLY file, without the body.

    Raises InvalidInput if it is not the header of a PLY file.
    """
    lines, size = _split_lines(data)
    byte_order: str | None = None
    elements: dict[str, Element] = {}
    element: Element | None = None
    comments: list[str] = []
    obj_info = odd_comments = 0
    for number, line in enumerate(lines, 2):
        words = line.split()
        if not words:
            continue
        if words[0] == "comment":
            text = line.strip()[len("comment ") :]
            plain = _PLAIN.fullmatch(text) is not None
            comments += [text] if plain else []
            odd_comments += not plain
        elif words[0] == "obj_info":
            obj_info += 1
        elif words[0] == "format" and byte_order is None:
            byte_order = _parse_format(words, number)
        elif words[0] == "element" and byte_order is not None:
            element = _parse_element(words, number, elements)
            elements[element.name] = element
        elif words[0] == "property" and element is not None:
            _parse_property(words, number, element)
        else:
            raise _error(number, f"{line[:60]!a} is not expected there")
    if byte_order is None:
        raise _error(len(lines) + 2, "no format")
    return PlyHeader(byte_order, elements, tuple(comments), odd_comments, obj_info, size)


def _split_lines(data: memoryview | FileBytes) -> tuple[list[str], int]:
    """The lines between ``ply`` and ``end_header``, and the start of the body."""
    head = data[:_FIRST_BYTES]
    start = re.match(rb"(?:%b)?ply[ \t]*(\r\n|\n|\r)" % BOM_UTF8, head)
    if not start:
        raise _error(1, f"{bytes(head[:20])!a}, expected 'ply'")
    # Only one kind of line end counts: the first byte of the body may look like part of another
    # kind.
    newline = start[1]
    ending = re.compile(rb"(?<=[\r\n])end_header[ \t]*" + newline)
    end = ending.search(head, start.end())
    if not end:
        head = data[:_HEADER_BYTES]
        end = ending.search(head, start.end())
    if not end:
        where = "beyond 16 MiB" if len(head) == _HEADER_BYTES else "early end-of-file"
        raise InvalidInput(f"not a readable PLY file (no end of the header: {where})")
    # The specification says ASCII, but comments and program names may differ.
    raw = bytes(head[start.end() : end.start()])
    try:
        text = raw.decode()
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return text.split(newline.decode())[:-1], end.end()


def _parse_format(words: list[str], line: int) -> str:
    if len(words) != 3 or words[1] not in _FORMATS or words[2] != "1.0":
        expected = ", ".join(_FORMATS)
        raise _error(line, f"format {' '.join(words[1:])[:60]!a}, expected 1.0 of {expected}")
    return _FORMATS[words[1]]


def _parse_element(words: list[str], line: int, before: dict[str, Element]) -> Element:
    if len(words) != 3 or not _COUNT.fullmatch(words[2]):
        raise _error(line, f"element {' '.join(words[1:])[:60]!a}, expected a name and a count")
    if words[1] in before:
        raise _error(line, f"two elements of the same name {words[1][:60]!a}")
    if len(before) == _ELEMENTS:
        raise _error(line, f"more than {_ELEMENTS} elements")
    return Element(words[1], int(words[2]))


def _parse_property(words: list[str], line: int, element: Element) -> None:
    is_list = words[1:2] == ["list"]
    types = words[2:4] if is_list else words[1:2]
    if len(words) != (5 if is_list else 3) or not all(name in _TYPES for name in types):
        raise _error(line, f"property {' '.join(words[1:])[:60]!a}, expected a type and a name")
    name = words[-1]
    if name in element.types or name in element.lists:
        raise _error(line, f"two properties of the same name {name[:60]!a}")
    if len(element.types) + len(element.lists) == _PROPERTIES:
        raise _error(line, f"more than {_PROPERTIES} properties")
    if is_list:
        element.lists[name] = _TYPES[types[1]]
    else:
        element.types[name] = _TYPES[types[0]]


def _error(line: int, what: str) -> InvalidInput:
    return InvalidInput(f"not a readable PLY file (line {line}: {what})")
