"""Remote storage at URLs, through fsspec and its installed protocols."""

from __future__ import annotations

import errno
import logging
import os
import posixpath
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gs_codec.batch.local import (
    LocalStorage,
    Location,
    Stamp,
    by_folder,
    file_sha256,
    fixed_part,
    scenes_among,
)
from gs_codec.errors import GsCodecError, InvalidInput, MissingTool, one_line
from gs_codec.format_table import BATCHED
from gs_codec.runtime.atomic import leftovers, possible_name, temporary_name
from gs_codec.runtime.optional import needed, pip_install
from gs_codec.runtime.redaction import redacted, without_secrets
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

_READ_ONLY = ("http", "https")

#: fsspec's protocol for the memory of one process, which workers cannot share.
_OWN = "memory"

#: Object stores: a file appears when it is closed; there are no folders and no renaming.
_OBJECTS = ("s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "oss")

#: Check hosts against ~/.ssh/known_hosts, like ssh (sshfs itself trusts any host), and give up on a
#: host that does not answer.
_SSH = {"known_hosts": (), "connect_timeout": 60, "keepalive_interval": 30}

#: Seconds to wait for a web server.
_PATIENCE = 60

#: Maximum depth of folders to read.
_DEEPEST = 32

#: Maximum share of the free disk space for a file of unknown size.
_FILLED = 0.9

#: Maximum length of an error text to show, because a server may have written it.
_MOST = 1000

#: Protocols installed by the extra; for all others, fsspec names the package.
_INSTALLED = (*_READ_ONLY, "ssh", "sftp")


class RemoteStorage:
    """Storage that fsspec reaches at URL `base`; see `LocalStorage` for the methods.

    Raises InvalidInput or MissingTool if its protocol is unknown, the package for it is not
    installed, or it cannot be reached.
    """

    def __init__(self, base: str) -> None:
        self._base = base
        # In a chain of fsspec, each protocol reads from the next one.
        self._protocols = [part.partition("://")[0] for part in base.split("::")]
        self._name = without_secrets(base)
        self._read_only = [name for name in self._protocols if name in _READ_ONLY]
        self._is_store = self._protocols[0] in _OBJECTS
        if _OWN in self._protocols:
            text = "storage of this process, expected one that workers can reach"
            raise InvalidInput(f"{self._name}: {text}")
        self._fs, self._root = self._open()
        shown, root = self._name.rstrip("/"), self._root.rstrip("/")
        self._prefix = shown.removesuffix(root) if shown.endswith(root) else ""

    def _open(self) -> tuple[Any, str]:
        fsspec = needed("fsspec", self._name)
        # Each protocol of a chain has its own options.
        options: dict[str, Any] = {
            name: dict(_SSH) for name in ("ssh", "sftp") if name in self._protocols
        }
        try:
            if self._read_only:
                from aiohttp import ClientTimeout

                # By default, aiohttp ends downloads after five minutes.
                waits = ClientTimeout(total=None, sock_connect=_PATIENCE, sock_read=_PATIENCE)
                options |= {name: {"client_kwargs": {"timeout": waits}} for name in self._read_only}
            return fsspec.core.url_to_fs(self._base, **options)
        except ImportError as error:
            text = redacted(one_line(error), self._base)
            known = any(name in _INSTALLED for name in self._protocols)
            hint = f"; {pip_install('cluster')}" if known else ""
            raise MissingTool(f"{self._name}: {text}{hint}") from error
        except Exception as error:
            raise InvalidInput(f"{self._name}: {_cause(error, self._base)}") from error

    @contextmanager
    def _named(self, location: Location | None = None) -> Iterator[None]:
        """Convert any error of a backend to one line that names the storage or file."""
        path = self._base if location is None else location.path
        shown = self._name if location is None else self.shown(location)
        try:
            yield
        except GsCodecError:
            raise
        except Exception as error:
            text = _cause(error, self._base, path)
            named = (shown, without_secrets(path))
            if isinstance(error, FileNotFoundError) and text in named:
                text = os.strerror(errno.ENOENT)
                cause = error.__cause__
                # A web server that refuses or does not answer; fsspec's error is the same.
                if self._read_only and cause is not None and getattr(cause, "status", 0) != 404:
                    text = _cause(cause, self._base, path)
            raise InvalidInput(f"{shown}: {text}") from error

    def find(self, suffixes: tuple[str, ...] = BATCHED) -> list[tuple[str, Location]]:
        """See `LocalStorage.find`; a web address is a folder if it ends in a slash."""
        wild = "*[" if self._read_only else "*[?"
        root = self._root
        with self._named():
            if any(sign in root for sign in wild):
                root, glob = fixed_part(root, wild), root
                found = self._matching(glob, root)
            elif self._base.endswith("/") if self._read_only else self._fs.isdir(root):
                found = self._below(root)
                found = {path: found[path] for path in scenes_among(found, suffixes)}
            else:
                found = {root: self._fs.info(root)}
                root = posixpath.dirname(root)
        paths = sorted(path for path, info in found.items() if info.get("type") != "directory")
        root = without_secrets(root)
        names = [without_secrets(path).removeprefix(root).lstrip("/") for path in paths]
        return [(name, self._at(path)) for name, path in zip(names, paths, strict=True)]

    def _matching(self, glob: str, root: str) -> dict[str, Any]:
        """Files below a folder that match a glob."""
        from fsspec.utils import glob_translate

        if self._is_store or "**" not in glob:
            return self._fs.glob(glob, detail=True)
        found, wanted = self._below(root), re.compile(glob_translate(glob))
        return {path: info for path, info in found.items() if wanted.match(path)}

    def _below(self, root: str) -> dict[str, Any]:
        """All files below a folder; rejects too deep ones, because links may lead back up."""
        if self._is_store:
            return self._fs.find(root, detail=True)
        found: dict[str, Any] = {}
        waiting = [(f"{root.rstrip('/')}/", 0)]
        while waiting:
            folder, depth = waiting.pop()
            if depth > _DEEPEST:
                shown = self.shown(self._at(folder))
                raise InvalidInput(
                    f"{shown}: {counted(depth, 'folder')} deep; links may form a cycle"
                )
            for path, info in self._listed(folder, depth):
                if info.get("type") != "directory":
                    found[path] = info
                elif posixpath.basename(path.rstrip("/")) not in ("", ".", ".."):
                    waiting.append((f"{path.rstrip('/')}/", depth + 1))
        return found

    def _listed(self, folder: str, depth: int) -> list[tuple[str, dict[str, Any]]]:
        """Entries of a folder; a subfolder that cannot be read causes a warning."""
        try:
            entries = self._fs.ls(folder, detail=True)
        except FileNotFoundError:  # raised by fsspec for an empty web folder
            return []
        except OSError as error:
            if not depth:
                raise
            shown = self.shown(self._at(folder))
            log.warning("%s: %s, skipped", shown, _cause(error, self._base, folder))
            return []
        return [(e["name"], e) for e in entries if e["name"].rstrip("/") != folder.rstrip("/")]

    def location(self, name: str) -> Location:
        """See `LocalStorage.location`."""
        return self._at(posixpath.join(self._root, name))

    def _at(self, path: str) -> Location:
        return Location(path, self._base)

    def shown(self, location: Location) -> str:
        """See `LocalStorage.shown`."""
        return self._prefix + without_secrets(location.path)

    def check_folder(self) -> None:
        """See `LocalStorage.check_folder`."""
        if self._read_only or len(self._protocols) > 1:
            kind = self._read_only[0] if self._read_only else "a chain of protocols"
            raise InvalidInput(f"{self._name}: {kind} is read-only")
        if not self._is_store:
            with self._named():
                self._fs.makedirs(self._root, exist_ok=True)

    def stamp(self, location: Location) -> Stamp | None:
        """See `LocalStorage.stamp`."""
        with self._named(location):
            try:
                info = self._fs.info(location.path)
            except FileNotFoundError:
                return None
        keys = (
            "mtime", "LastModified", "Last-Modified", "last_modified", "updated", "created", "ETag",
        )  # fmt: skip
        modified = next((str(info[key]) for key in keys if info.get(key)), "")
        size = info.get("size")
        return Stamp(size if isinstance(size, int) else -1, modified)

    def sha256(self, location: Location) -> str:
        """See `LocalStorage.sha256`."""
        with tempfile.TemporaryDirectory() as folder:
            return file_sha256(self.fetch(location, Path(folder)))

    def fetch(self, location: Location, folder: Path) -> Path:
        """See `LocalStorage.fetch`; checks that the copy fits the disk and has the stated size."""
        from fsspec.callbacks import Callback

        shown, stamp = self.shown(location), self.stamp(location)
        if stamp is None:
            raise InvalidInput(f"{shown}: {os.strerror(errno.ENOENT)}")
        if stamp.size > (free := shutil.disk_usage(folder).free):
            raise InvalidInput(f"{shown}: {counted(stamp.size, 'byte')}, {free:,} free in {folder}")
        name = posixpath.basename(without_secrets(location.path)) or "scene"
        target = folder / possible_name(name)
        most = stamp.size if stamp.size >= 0 else int(_FILLED * free)

        def check(_: int | None, value: int, **__: Any) -> None:
            if value > most:
                raise InvalidInput(f"{shown}: more than {counted(most, 'byte')} received")

        with self._named(location):
            self._fs.get_file(location.path, str(target), callback=Callback(hooks={"most": check}))
            size = target.stat().st_size
        if stamp.size not in (-1, size):
            raise InvalidInput(
                f"{shown}: {counted(size, 'byte')} received, expected {stamp.size:,}"
            )
        return target

    def store(self, file: Path, location: Location, mark: str) -> None:
        """Copy a file to the storage, atomically; `mark` identifies the batch."""
        with self._named(location):
            if self._is_store:
                self._fs.put_file(str(file), location.path)
                return
            folder, _, name = location.path.rpartition("/")
            begun = posixpath.join(folder, temporary_name(name, mark))
            self._fs.makedirs(folder, exist_ok=True)
            try:
                self._fs.put_file(str(file), begun)
                self._fs.mv(begun, location.path)
            except BaseException:
                with suppress(Exception):
                    self._fs.rm_file(begun)
                raise

    def sweep(self, locations: Iterable[Location], mark: str) -> None:
        """See `LocalStorage.sweep`."""
        if self._is_store:
            return
        for folder, names in by_folder(locations).items():
            with self._named():
                try:
                    entries = [posixpath.basename(p) for p in self._fs.ls(folder, detail=False)]
                except FileNotFoundError:
                    continue
                for entry in leftovers(entries, names, mark):
                    self._fs.rm_file(posixpath.join(folder, entry))


Storage = LocalStorage | RemoteStorage


def is_url(text: str) -> bool:
    """Whether this is a URL of remote storage; ``file://`` is not."""
    return "://" in text and not text.startswith("file://")


def storage_of(base: str) -> Storage:
    """The storage of a path or URL; raises like `RemoteStorage`."""
    return RemoteStorage(base) if is_url(base) else LocalStorage(base)


def _cause(error: BaseException, *urls: str) -> str:
    """Text of an error, or its type if it has no text; without the secrets of `urls`."""
    text = redacted(one_line(error), *urls) or type(error).__name__
    return text if len(text) <= _MOST else f"{text[:_MOST]}..."
