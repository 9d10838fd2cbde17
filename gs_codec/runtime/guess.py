"""Guess what a file that is not a scene is, so that errors can name it."""

from __future__ import annotations

from codecs import BOM_UTF8

#: Bytes at the beginning of a file that are examined.
LOOKED_AT = 512

_LFS = "a Git LFS pointer, not the file itself (`git lfs pull` fetches it)"
_SPX = "an .spx scene of Reall3D, not one that is read (gsbox converts it to .ply)"
_HTML = "an HTML page, not a scene (a server may answer with one in place of a file)"

#: Beginnings of text files, in lower case and without leading white space.
_TEXTS = {
    b"version https://git-lfs": _LFS,
    b"<!doctype html": _HTML,
    b"<html": _HTML,
    b"<head": _HTML,
    b"<?xml": "an XML document, not a scene",
    b'{\n "project": ': "a project of the viewer, not a scene (its edits apply to its scenes)",
}
_SIGNATURES = {
    b"\x89PNG\r\n\x1a\n": "a PNG image, not a scene",
    b"\xff\xd8\xff\xe0": "a JPEG image, not a scene",
    b"\xff\xd8\xff\xe1": "a JPEG image, not a scene",
    b"%PDF-": "a PDF document, not a scene",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive, not a scene: unpack it",
    b"Rar!\x1a\x07": "a RAR archive, not a scene: unpack it",
    **dict.fromkeys((b"spx\x01", b"spx\x02", b"spx\x03"), _SPX),
}


def looks_like(head: bytes) -> str:
    """Describe a file that is not a scene, from its first `LOOKED_AT` bytes; "" if unknown."""
    text = head.removeprefix(BOM_UTF8).lstrip().lower()
    found = [words for begin, words in _TEXTS.items() if text.startswith(begin)]
    found += [words for begin, words in _SIGNATURES.items() if head.startswith(begin)]
    return found[0] if found else ""


def text_kind(head: bytes) -> str:
    """Describe the text in the first `LOOKED_AT` bytes; "" if they are not text."""
    try:
        text = head.decode()
    except UnicodeDecodeError as error:
        if error.reason != "unexpected end of data":  # a character that is cut off
            return ""
        text = head[: error.start].decode()
    if not all(character.isprintable() or character in "\t\r\n" for character in text):
        return ""
    return "JSON" if text.lstrip()[:1] in ("{", "[") else "text" if text else ""
