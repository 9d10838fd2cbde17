"""Put the script of the inspection into a page, and a second scene; count its views."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from urllib.parse import quote

_SCENES = b'<script type="application/json" id="scene-list">'
_POLICY = b"script-src '"
_END = b"</body>"


def with_inspection(page: bytes, calls: str, is_open: bool) -> bytes:
    """The page with the script, which its policy then allows; `is_open` shows it at once.

    The script sends its calls to the address `calls`.
    """
    script = Path(__file__).with_name("web").joinpath("inspect.js").read_bytes()
    allowed = base64.b64encode(hashlib.sha256(script).digest())
    page = page.replace(_POLICY, b"%b'sha256-%b' '" % (_POLICY[:-1], allowed), 1)
    before, end, after = page.rpartition(_END)
    told = f' data-calls="{calls}"' + is_open * ' data-open="1"'
    start = b'<script type="module" id="inspection"%b>' % told.encode()
    return before + start + script + b"</script>\n" + end + after


def count_views(page: bytes) -> int:
    """The number of views of a page."""
    listed, _, _ = page.partition(_SCENES)[2].partition(b"</script>")
    return len(json.loads(listed)["views"])


def with_second(page: bytes, name: str, file: str) -> bytes:
    """The page with an `.egs` file of its folder as its second scene."""
    before, start, rest = page.partition(_SCENES)
    listed, end, after = rest.partition(b"</script>")
    shown = json.loads(listed)
    entry = {"name": name, "encoded": False, "levels": False, "url": quote(file)}
    shown["scenes"] = [shown["scenes"][0], entry]
    text = json.dumps(shown, allow_nan=False).replace("<", "\\u003c")
    return before + start + text.encode() + end + after
