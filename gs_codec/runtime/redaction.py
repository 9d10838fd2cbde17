"""Remove the secrets of URLs from text: passwords, tokens used as accounts, signed queries."""

from __future__ import annotations

import base64
import logging
import re
import sys
import traceback
from functools import lru_cache
from types import TracebackType
from urllib.parse import unquote

#: Separator of chained URLs, as in ``simplecache::https://host/scene.ply``.
_CHAIN = re.compile(r"::(?=[A-Za-z][\w+.-]*(?:://|::))")

_URL = re.compile(r"([A-Za-z][\w+.-]*://)(.*)", re.DOTALL)

#: A URL in a text, and the quotes, brackets and punctuation that may follow it.
_URL_IN_TEXT = re.compile(r"[A-Za-z][\w+.-]{0,30}://\S+")
_AFTER = "'\"()<>[],.;:"

_HEADER = re.compile(r"(?i)(authorization['\"]?\s*[:=,]\s*['\"]?(?:(?:basic|bearer)\s+)?)[^\s'\"]+")

#: The query after a path without its host, as a server may print it.
_QUERY = re.compile(r"(?<=[\w/])\?[^\s'\"=]*=[^\s'\"]*")

#: Protocols whose accounts may be tokens, and whose queries are not part of a file name.
_WEB = ("http://", "https://")

#: Protocols whose paths are file names, which may contain any character.
_FILES = ("file://", "local://", "sftp://", "ssh://", "ftp://", "memory://")

#: A secret with fewer characters may occur inside other words; it is hidden only as a whole word.
_SHORT = 8

#: Query values with fewer characters, such as page numbers, cannot be signatures.
_SIGNATURE = 4

_HIDDEN = "***"


def without_secrets(url: str) -> str:
    """A URL, or a chain of URLs, without passwords and without queries that may sign it.

    Accounts of web addresses are removed too. Text that is not a URL is returned unchanged.
    """
    return "::".join(_parted(part)[0] for part in _links(url))


def redacted(text: str, *urls: str) -> str:
    """A message of a library or server, without the secrets of the URLs in it.

    Parameters
    ----------
    text : str
    urls : str
        URLs whose secrets are hidden everywhere in the text, however they are escaped.
    """
    for url in urls:
        if (shown := without_secrets(url)) != url:
            text = text.replace(url, shown)
            for pattern in _spellings(url):
                text = pattern.sub(_HIDDEN, text)
    text = _URL_IN_TEXT.sub(_shown_in_text, text)
    if any(name in url.lower() for url in urls for name in _WEB):
        text = _QUERY.sub("", text)
    return _HEADER.sub(rf"\g<1>{_HIDDEN}", text)


def redact_process() -> None:
    """Keep secrets of URLs out of this process's logs and tracebacks."""
    for handler in (*logging.root.handlers, logging.lastResort):
        if handler is not None and not isinstance(handler.formatter, _Redacting):
            handler.setFormatter(_Redacting(handler.formatter))
    sys.excepthook = _write_traceback


class _Redacting(logging.Formatter):
    """Removes secrets from the output of another formatter, including tracebacks."""

    def __init__(self, inner: logging.Formatter | None) -> None:
        super().__init__()
        self._inner = inner or logging.Formatter()

    def format(self, record: logging.LogRecord) -> str:
        return redacted(self._inner.format(record))


def _shown_in_text(found: re.Match[str]) -> str:
    url = found[0].rstrip(_AFTER)
    return without_secrets(url) + found[0][len(url) :]


def _write_traceback(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    sys.stderr.write(redacted("".join(traceback.format_exception(kind, error, trace))))


def _links(url: str) -> list[str]:
    """The URLs of a chain; a web URL is always the last, because its query may contain ``::``."""
    web = re.search("(?i)(?:^|::)https?://", url)
    if web is None:
        return _CHAIN.split(url)
    start = web.start() + 2 * web[0].startswith("::")
    return [*(_CHAIN.split(url[: web.start()]) if start else []), url[start:]]


def _parted(url: str) -> tuple[str, list[str]]:
    """A URL without its secrets, and the secrets."""
    if (match := _URL.fullmatch(url)) is None:
        return url, []
    scheme, rest = match[1].lower(), match[2]
    account, rest = _without_account(rest)
    user, _, password = re.sub("%3[aA]", ":", account).partition(":")
    # Other parsers end a part at a character that should have been escaped.
    secrets = [password, *re.split("[/?#@]", password)]
    if scheme in _WEB:
        token, user = user, ""
        pair = f"{token}:{password}" if password else token
        # The second is what the Authorization header of a request contains.
        secrets += [
            pair,
            base64.b64encode(unquote(pair).encode("utf-8", "surrogateescape")).decode(),
        ]
    rest, query = _without_query(scheme, rest)
    parts = [*re.split("[?#&]", query), *re.split("[?#&;]|::", query)]
    values = [part.partition("=")[2] or part for part in parts]
    secrets += [value for value in values if len(value) >= _SIGNATURE]
    shown = match[1] + (f"{user}@" if user else "") + rest
    return shown, [secret for secret in secrets if secret]


def _without_account(rest: str) -> tuple[str, str]:
    """Split a URL without its scheme into its account and the rest."""
    authority = re.split("[/?#]", rest, maxsplit=1)[0]
    port = authority.rpartition("]")[2].partition(":")[2]
    if "@" in authority:
        account = authority.rpartition("@")[0]
    elif "@" in rest and port and not port.isdigit():
        # A password with characters that should be escaped, such as a slash.
        account = rest.rpartition("@")[0]
    else:
        return "", rest
    return account, rest[len(account) + 1 :]


def _without_query(scheme: str, rest: str) -> tuple[str, str]:
    """Split host and path from the query, unless the query is part of a file name."""
    path = re.split("[?#]", rest, maxsplit=1)[0]
    query = rest[len(path) :]
    if scheme in _WEB or (scheme not in _FILES and "=" in query):
        return path, query
    return rest, ""


@lru_cache
def _spellings(url: str) -> list[re.Pattern[str]]:
    """Patterns that find each secret of a URL, however it is escaped; the longest first."""
    secrets = {unquote(one) for part in _links(url) for one in _parted(part)[1]}
    return [_spelling(secret) for secret in sorted(secrets, key=len, reverse=True)]


def _spelling(secret: str) -> re.Pattern[str]:
    signs = []
    for sign in secret:
        # A plus may stand for a space, and an escape may itself be escaped.
        meant = "+ " if sign in "+ " else sign
        escaped = [
            "".join(f"%(?:25){{0,3}}(?i:{b:02x})" for b in one.encode("utf-8", "surrogateescape"))
            for one in meant
        ]
        signs.append(rf"(?:\\{{0,4}}(?:{'|'.join(map(re.escape, meant))})|{'|'.join(escaped)})")
    word = "".join(signs)
    if len(secret) < _SHORT:
        word = rf"(?:(?<![A-Za-z0-9])|(?<=%[0-9A-Fa-f]{{2}})){word}(?![A-Za-z0-9])"
    return re.compile(word)
