"""Check that arguments of public functions and classes have the types of their annotations."""

from __future__ import annotations

import builtins
import os
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import fields
from functools import cache, wraps
from inspect import signature
from numbers import Integral, Real
from pathlib import PurePath
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin

from gs_codec.errors import InvalidInput

Public = TypeVar("Public", bound=Callable[..., Any])


def checked(function: Public) -> Public:
    """Make a function raise `InvalidInput` for an argument of a wrong type."""
    described = signature(function)

    @wraps(function)
    def called(*arguments: Any, **options: Any) -> Any:
        hints = _hints_of(cast(Hashable, function))
        for name, value in described.bind(*arguments, **options).arguments.items():
            _check(name, value, hints.get(name, _ANYTHING))
        return function(*arguments, **options)

    return cast(Public, called)


def check_fields(settings: Any) -> None:
    """Raise `InvalidInput` if a field of a dataclass has a value of a wrong type."""
    hints = _hints_of(cast(Hashable, type(settings)))
    for field in (each for each in fields(settings) if each.init):
        value = getattr(settings, field.name)
        _check(field.name, value, hints[field.name])
        if isinstance(value, Iterator):  # which is empty after its first use
            raise InvalidInput(f"{field.name}: {type(value).__name__}, expected a list or tuple")


#: An annotation as written, and the types that it denotes.
_Hint = tuple[str, Any]
_ANYTHING: _Hint = ("", Any)


def _check(name: str, value: Any, hint: _Hint) -> None:
    written, kind = hint
    if not _fits(value, kind):
        given = "None" if value is None else f"{type(value).__name__} {value!r:.40}"
        expected = written.removesuffix(" | None").replace(" | ", " or ")
        raise InvalidInput(f"{name}: {given}, expected {expected}")
    if "Path" in written:
        for each in value if isinstance(value, list | tuple) else [value]:
            if isinstance(each, str | PurePath) and not _is_possible(str(each)):
                raise InvalidInput(f"{name}: {str(each)!a:.60}, expected a possible path")


def _is_possible(path: str) -> bool:
    """Whether a file can have this path."""
    try:
        return b"\0" not in os.fsencode(path)
    except UnicodeEncodeError:
        return False


class _Names(dict):
    """Names in annotations; names imported only for type checkers count as Any."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


@cache
def _hints_of(public: Any) -> dict[str, _Hint]:
    """Annotations of a function's parameters or of a class's fields, as written and as types."""
    hints = {}
    for owner in reversed(getattr(public, "__mro__", (public,))):  # inherited fields, too
        names = _Names(vars(sys.modules[owner.__module__]))
        for name, text in getattr(owner, "__annotations__", {}).items():
            hints[name] = (str(text), eval(str(text), {}, names))
    return hints


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value has a type; if `kind` is not a type, any value fits."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_fits(value, each) for each in inner)
    if origin is Literal:
        return any(isinstance(value, type(each)) for each in inner)
    if kind in (int, float):
        return _is_number(value, kind)
    if isinstance(origin, type):
        return _holds(value, origin, inner)
    kind = NoneType if kind is None else kind
    return kind is Any or not isinstance(kind, type) or isinstance(value, kind)


def _is_number(value: Any, kind: type) -> bool:
    """Whether a value is a number; an integer is accepted as a float."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        number = float(value)
    except OverflowError:
        return False
    return kind is float or isinstance(value, Integral) or number.is_integer()


def _holds(value: Any, origin: type, inner: tuple[Any, ...]) -> bool:
    """Whether a value is an array, a sequence, a mapping or a function, as its type requires."""
    if origin.__module__ == "numpy":
        import numpy as np  # not needed for help

        array = np.asarray(value if isinstance(value, np.ndarray | list | tuple) else "")
        return array.dtype.kind in "biuf"
    plain = origin.__module__ in ("builtins", "collections.abc")
    if not plain or issubclass(origin, Mapping) or not issubclass(origin, Iterable):
        return isinstance(value, origin)
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return False
    # Items of iterators and arrays are checked where they are used.
    return not (inner and isinstance(value, list | tuple)) or all(_fits(v, inner[0]) for v in value)
