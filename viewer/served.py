"""The browser page, served on this machine."""

from __future__ import annotations

import json
import os
import re
import secrets
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedIOBase
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote, urlencode

import gs_codec
from gs_codec.cli.main import describe_error
from gs_codec.cli.output import print_text
from gs_codec.egs.frame_sections import is_sequence
from gs_codec.files.sharing import PAGE, page_of
from gs_codec.report import Progress
from gs_codec.runtime.arrays import folder_on_disk
from gs_codec.sequences.frame_decoding import opened_sequence
from gs_codec.views.estimate import COUNT
from viewer.inspected_page import count_views, with_inspection, with_second

if TYPE_CHECKING:
    from viewer.inspector import Inspector
    from viewer.scenes.view_request import Request

#: Address of this machine only.
_HOST = "127.0.0.1"

#: Maximum time without data on a connection, seconds.
_SILENT = 10.0

#: Bytes that are sent at once.
_PIECE = 1 << 16

#: Maximum size of a call of the inspection, bytes.
_CALL = 1 << 16

#: Maximum size of a dropped file, bytes; as in the page.
_DROPPED = 1 << 31

#: Maximum number of connections; a browser opens six.
_CONNECTIONS = 64


class Page(ThreadingHTTPServer):
    """Serves a page to users of this machine who know its address.

    Parameters
    ----------
    files : dict of str to bytes
        Files by name; `PAGE` is the page at the address itself.
    port : int
        Port; 0 selects a free one.
    inspector : Inspector, optional
        Answers the inspection of the page.
    start : str
        What the page shows first, as the part of its address after ``#``.

    Attributes
    ----------
    url : str
        The address, with an unguessable random part.
    show : callable or None
        Shows the scene of a file that is dropped on the page.
    """

    daemon_threads = True

    def __init__(
        self,
        files: dict[str, bytes],
        port: int = 0,
        inspector: Inspector | None = None,
        start: str = "",
    ) -> None:
        self.inspector: Inspector | None = None
        self._dropped, self._showing = ExitStack(), threading.Lock()
        super().__init__((_HOST, port), _Handler)
        self.root = f"/{secrets.token_urlsafe(16)}/"
        self.put(files, inspector)
        self.show: Callable[[Path], None] | None = None
        self.url = f"http://{_HOST}:{self.server_port}{self.root}{start and '#'}{start}"
        self._free = threading.BoundedSemaphore(_CONNECTIONS)

    def put(self, files: dict[str, bytes], inspector: Inspector | None) -> None:
        """Serve these files, and an inspection of the page, instead of those before."""
        if self.inspector is not None:
            self.inspector.close()
        contents = {self.root + quote(name): data for name, data in files.items()}
        contents[self.root] = contents.pop(self.root + PAGE)
        self.contents, self.inspector = contents, inspector

    def take(self, name: str, file: BufferedIOBase, size: int) -> None:
        """Read a dropped file, and show it; if that fails, all stays. Raises GsCodecError."""
        made = tempfile.TemporaryDirectory(
            prefix="gs-viewer-", dir=folder_on_disk(), ignore_cleanup_errors=True
        )
        left = size
        with ExitStack() as stack:
            folder = stack.enter_context(made)
            path = Path(folder) / name
            try:
                with open(path, "wb") as copy:
                    while piece := file.read(min(left, _PIECE)):
                        left -= len(piece)
                        copy.write(piece)
                if left:
                    raise gs_codec.GsCodecError(f"{name}: only a part of it has arrived")
                with self._showing:
                    if self.show is not None:
                        self.show(path)
                    self._dropped.close()
                    self._dropped = stack.pop_all()
            except (gs_codec.GsCodecError, OSError, MemoryError, ValueError) as error:
                with suppress(OSError):  # browsers take no answer before they have sent all
                    while left and (piece := file.read(min(left, _PIECE))):
                        left -= len(piece)
                text = describe_error(error).replace(f"{folder}{os.sep}", "")
                raise gs_codec.GsCodecError(text) from error

    def verify_request(self, request: object, client_address: object) -> bool:
        """Whether to serve a connection; its thread frees its place at the end."""
        return self._free.acquire(blocking=False)

    def process_request_thread(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: object
    ) -> None:
        """Serve a connection in a thread of its own."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def find(self, path: str) -> bytes | None:
        """The bytes at an address: a file, a trial encoding, or the page with one as B."""
        root = re.escape(self.root)
        found = re.fullmatch(rf"{root}(?:trial-(\d{{1,6}})\.egs|\?b=(\d{{1,6}}))", path)
        if found is None or self.inspector is None:
            return self.contents.get(path)
        tried = self.inspector.trial(int(found[1] or found[2]))
        if tried is None:
            return None
        if found[1]:
            return tried.path.read_bytes()
        return with_second(self.contents[self.root], tried.name, f"trial-{tried.number}.egs")

    def run(self) -> None:
        """Print the address, open a browser if there is a screen, and serve until Ctrl-C."""
        print_text(f"{self.url}  (Ctrl-C stops the server)")
        with ExitStack() as stack:
            if _has_screen():
                webbrowser.open(stack.enter_context(_leading_to(self.url)))
            elif "SSH_CONNECTION" in os.environ:
                port, there = self.server_port, "then open this address"
                print_text(f"from another machine: ssh -L {port}:{_HOST}:{port} HOST, {there}")
            stack.callback(lambda: self.inspector.close() if self.inspector else None)
            stack.callback(self.server_close)
            stack.enter_context(suppress(KeyboardInterrupt))
            sys.stdout.flush()  # may be a pipe, as over SSH
            self.serve_forever()

    def server_close(self) -> None:
        """Serve no more, and remove the dropped file."""
        super().server_close()
        self._dropped.close()

    def handle_error(self, request: object, client_address: object) -> None:
        """Log nothing about interrupted connections, which occur when a page is closed."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Handler(BaseHTTPRequestHandler):
    server: Page
    timeout = _SILENT

    def do_GET(self) -> None:
        data = self._head()
        if data is not None:
            self._write(data)

    def do_HEAD(self) -> None:
        self._head()

    def do_POST(self) -> None:
        """Answer a call of the inspection."""
        inspector = self.server.inspector if self._is_from_here else None
        if inspector is None or self.path != self.server.root + inspector.address:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        length = self._length(_CALL)
        if length is None:
            return
        try:
            answer = inspector.answer(json.loads(self.rfile.read(length)))
            status = HTTPStatus.OK if answer else HTTPStatus.CONFLICT
            kind, data, facts = answer or ("text/plain", b"", {})
        except (gs_codec.GsCodecError, OSError, MemoryError, ValueError, RecursionError) as error:
            status, facts = HTTPStatus.BAD_REQUEST, {}
            kind, data = "text/plain; charset=utf-8", describe_error(error).encode()
        told = {"Facts": json.dumps(facts)} if facts else {}
        self._send(status, kind, len(data), told)
        self._write(data)

    def do_PUT(self) -> None:
        """Show a file dropped on the page in place of its scenes."""
        name = unquote(self.path.removeprefix(self.server.root))
        is_name = self.path.startswith(self.server.root) and Path(name).name == name
        if not (self._is_from_here and self.server.show and is_name):
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        length = self._length(_DROPPED)
        if length is None:
            return
        status, data = HTTPStatus.OK, b""
        try:
            self.server.take(name, self.rfile, length)
        except (gs_codec.GsCodecError, OSError) as error:
            status, data = HTTPStatus.BAD_REQUEST, describe_error(error).encode()
        self._send(status, "text/plain; charset=utf-8", len(data), {})
        self._write(data)

    def _length(self, most: int) -> int | None:
        """The size of the request's body; None, after an error, if it is unknown or larger."""
        length = self.headers.get("Content-Length", "")
        if re.fullmatch(rf"\d{{1,{len(str(most))}}}", length) and int(length) <= most:
            return int(length)
        self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        return None

    @property
    def _is_from_here(self) -> bool:
        """Whether the request names this host; pages of other sites could send others."""
        return self.headers.get("Host", "").partition(":")[0] in (_HOST, "localhost")

    def _head(self) -> bytes | None:
        """Send the response headers of a file or a range of one, and return its bytes."""
        data = self.server.find(self.path) if self._is_from_here else None
        if data is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        is_page = self.path.partition("?")[0] == self.server.root
        kind = "text/html; charset=utf-8" if is_page else "application/octet-stream"
        whole = len(data)
        part = _range_of(self.headers.get("Range", ""), whole)
        if part is not None:
            data = data[part.start : part.stop]
            if not data:
                self.send_error(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
                return None
        status, told = HTTPStatus.OK, {"Accept-Ranges": "bytes"}
        if part is not None:
            status = HTTPStatus.PARTIAL_CONTENT
            told["Content-Range"] = f"bytes {part.start}-{part.stop - 1}/{whole}"
        self._send(status, kind, len(data), told)
        return data

    def _send(self, status: HTTPStatus, kind: str, length: int, told: dict[str, str]) -> None:
        """Send the headers of a response."""
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(length)),
            *told.items(),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
        ):
            self.send_header(name, value)
        self.end_headers()

    def _write(self, data: bytes) -> None:
        """Send the body of a response; the timeout is that of a piece of it."""
        for begin in range(0, len(data), _PIECE):
            self.wfile.write(memoryview(data)[begin : begin + _PIECE])

    def log_message(self, *arguments: object) -> None:
        """Log no requests."""


@contextmanager
def _leading_to(url: str) -> Iterator[str]:
    """Address of a private file that redirects to `url`.

    All users can see a browser's arguments. The file is in the home folder, because sandboxed
    browsers cannot read folders for temporary files.
    """
    home = Path(os.path.expanduser("~"))  # stays "~" if it is unknown
    folder = home if os.access(home, os.W_OK) else None
    with tempfile.NamedTemporaryFile("w", prefix="gs-viewer-", suffix=".html", dir=folder) as file:
        file.write(f'<meta http-equiv="refresh" content="0; url={escape(url)}">\n')
        file.flush()
        yield Path(file.name).as_uri()


def _range_of(text: str, size: int) -> range | None:
    """The requested bytes of a file; None for all of them, or for unsupported kinds of range."""
    found = re.fullmatch(r"bytes=(\d{1,18})-(\d{0,18})", text)
    if found is None:
        return None
    first, last = int(found[1]), int(found[2] or size - 1)
    return range(first, max(first, min(last + 1, size)))


def serve(
    sources: Sequence[Path],
    request: Request,
    port: int | None = None,
    progress: Progress | None = None,
    inspector: Inspector | None = None,
) -> Page:
    """Make a server of a page that shows one or two scenes; see `gs_codec.files.sharing.share`.

    Of the request, the page takes cameras, up axis, limit, view and frame. With `inspector`, it
    inspects the scenes, unless it shows a sequence.

    Raises
    ------
    gs_codec.GsCodecError
        If the page cannot be made, there is no such view or frame, or the port is not available.
    """
    if port is not None and not 1 <= port <= 65535:
        raise gs_codec.GsCodecError(f"port {port}: expected 1 to 65535")
    cameras = request.cameras
    assert isinstance(cameras, str | Path)
    if request.view is not None:
        count = COUNT if request.chosen else len(gs_codec.read_cameras(cameras))
        _start(view=(request.view, count))
    if request.frame is not None:
        if not is_sequence(sources[0]):
            raise gs_codec.GsCodecError("frame: expected a sequence")
        with opened_sequence(sources[0]) as sequence:
            _start(frame=(request.frame, sequence.timeline.count))
    files, frames = _files_of(sources, request, inspector, progress)
    start = _start(view=(request.view, count_views(files[PAGE])), frame=(request.frame, frames))
    if inspector is not None and inspector.is_open and frames:
        raise gs_codec.GsCodecError("a sequence has no layers, photographs or report")
    try:
        page = Page(files, port or 0, None if frames else inspector, start)
    except OSError as error:
        raise gs_codec.GsCodecError(f"port {port}: {error.strerror or error}") from error

    def show(path: Path) -> None:
        from viewer.inspector import Inspector
        from viewer.scenes.view_request import Request

        wanted = Request(path, cameras="auto", max_bytes=request.max_bytes, up=request.up)
        with ExitStack() as stack:
            other = stack.enter_context(closing(Inspector(wanted)))
            files, frames = _files_of([path], wanted, other)
            page.put(files, None if frames else other)
            if not frames:
                stack.pop_all()

    page.show = None if inspector is None else show
    return page


def _files_of(
    sources: Sequence[Path],
    request: Request,
    inspector: Inspector | None,
    progress: Progress | None = None,
) -> tuple[dict[str, bytes], int]:
    """The files of a page, and the number of frames if it shows a sequence."""
    cameras, most = request.cameras, request.max_bytes
    assert isinstance(cameras, str | Path)
    shared, files = page_of(
        sources, cameras, alone=False, progress=progress, max_bytes=most, up=request.up
    )
    if inspector is not None:
        files[PAGE] = with_inspection(files[PAGE], inspector.address, inspector.is_open)
    return files, shared[0].frames


def _start(**wanted: tuple[int | None, int]) -> str:
    """The part of an address after ``#`` from the number of each thing and how many there are.

    Raises GsCodecError if there is no such thing.
    """
    given = {name: number for name, (number, _) in wanted.items() if number is not None}
    for name, number in given.items():
        if not 0 <= number < wanted[name][1]:
            raise gs_codec.GsCodecError(f"{name} {number}: expected 0 to {wanted[name][1] - 1}")
    return urlencode(given)


def _has_screen() -> bool:
    """Whether a browser window can be opened here."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform != "linux" or bool({"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ))
