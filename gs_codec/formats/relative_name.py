"""Names of files next to a file that refers to them."""

from __future__ import annotations

from typing import Any
from urllib.parse import unquote

from gs_codec.errors import InvalidInput


def relative_name(name: Any, where: str, quoted: bool = False) -> str:
    """The path of a file below the folder of another, with forward slashes.

    If `quoted`, it is percent-encoded. Raises InvalidInput if it leads elsewhere; `where` is the
    place of the name.
    """
    plain = isinstance(name, str) and name.isprintable()
    text = unquote(name) if plain and quoted else name
    plain = plain and text.isprintable() and not set(text) & set(":?#" if quoted else ":")
    parts = text.replace("\\", "/").split("/") if plain else [""]
    if parts[0] == "." and quoted:
        parts = parts[1:]
    if not parts or any(part.strip(".") == "" for part in parts):
        raise InvalidInput(f"{where}: file {name!a:.60}, expected one in its folder")
    return "/".join(parts)
