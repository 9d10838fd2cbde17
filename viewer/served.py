"""The browser page, served on this machine."""

from __future__ import annotations

import os
import re
import secrets
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

import gs_codec
from gs_codec.cameras.up import up_axis
from gs_codec.cli.output import print_text
from gs_codec.files.sharing import PAGE, page_of
from gs_codec.report import Progress

#: Address of this machine only.
_HOST = "127.0.0.1"

#: Maximum time without data on a connection, seconds.
_SILENT = 10.0

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

    Attributes
    ----------
    url : str
        The address, with an unguessable random part.
    """

    daemon_threads = True

    def __init__(self, files: dict[str, bytes], port: int = 0) -> None:
        super().__init__((_HOST, port), _Handler)
        root = f"/{secrets.token_urlsafe(16)}/"
        self.contents = {root + quote(name): data for name, data in files.items()}
        self.contents[root] = self.contents.pop(root + PAGE)
        self.url = f"http://{_HOST}:{self.server_port}{root}"
        self._free = threading.BoundedSemaphore(_CONNECTIONS)

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

    def run(self) -> None:
        """Print the address, open a browser if there is a screen, and serve until Ctrl-C."""
        print_text(f"{self.url}  (Ctrl-C stops the server)")
        with ExitStack() as stack:
            if _has_screen():
                webbrowser.open(stack.enter_context(_leading_to(self.url)))
            elif "SSH_CONNECTION" in os.environ:
                port, there = self.server_port, "then open this address"
                print_text(f"from another machine: ssh -L {port}:{_HOST}:{port} HOST, {there}")
            stack.callback(self.server_close)
            stack.enter_context(suppress(KeyboardInterrupt))
            self.serve_forever()

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
            self.wfile.write(data)

    def do_HEAD(self) -> None:
        self._head()

    def _head(self) -> bytes | None:
        """Send the response headers of a file or a range of one, and return its bytes."""
        # Reject other host names, through which pages of other sites could send requests.
        host = self.headers.get("Host", "").partition(":")[0]
        data = self.server.contents.get(self.path) if host in (_HOST, "localhost") else None
        if data is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        kind = "text/html; charset=utf-8" if self.path.endswith("/") else "application/octet-stream"
        whole = len(data)
        part = _range_of(self.headers.get("Range", ""), whole)
        if part is not None:
            data = data[part.start : part.stop]
            if not data:
                self.send_error(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
                return None
        self.send_response(HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT)
        if part is not None:
            self.send_header("Content-Range", f"bytes {part.start}-{part.stop - 1}/{whole}")
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(data))),
            ("Accept-Ranges", "bytes"),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
        ):
            self.send_header(name, value)
        self.end_headers()
        return data

    def log_message(self, *arguments: object) -> None:
        """Log no requests."""


@contextmanager
def _leading_to(url: str) -> Iterator[str]:
    """Address of a private file that redirects to `url`.

    All users can see a browser's arguments. The file is in the home folder, because sandboxed
    browsers cannot read folders for temporary files.
    """
    home = Path.home()
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
    cameras: str,
    port: int | None,
    max_bytes: int | None,
    progress: Progress | None,
    up: str | None = None,
) -> Page:
    """Make a server of a page that shows one or two scenes; see `gs_codec.files.sharing.share`.

    Raises
    ------
    gs_codec.GsCodecError
        If the page cannot be made, or the port is not available.
    """
    if port is not None and not 1 <= port <= 65535:
        raise gs_codec.GsCodecError(f"port {port}: expected 1 to 65535")
    if up is not None:
        up_axis(up)
    files = page_of(sources, cameras, alone=False, progress=progress, max_bytes=max_bytes, up=up)[1]
    try:
        return Page(files, port or 0)
    except OSError as error:
        raise gs_codec.GsCodecError(f"port {port}: {error.strerror or error}") from error


def _has_screen() -> bool:
    """Whether a browser window can be opened here."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform != "linux" or bool({"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ))
