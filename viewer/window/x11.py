"""Keyboard input from X11 that Open3D does not report: keys in text fields, the clipboard."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import os
import sys
import time
from typing import NamedTuple

#: Constants from X.h and keysymdef.h.
_KEY_PRESS = 2
_KEY_RELEASE = 3
_SELECTION = 31
_KEY_PRESS_MASK = 1
_SHIFT = 1
_CONTROL = 4
_POINTER_ROOT = 1
_KEYS = {"Tab": 0xFF09, "End": 0xFF57, "Return": 0xFF0D, "KP_Enter": 0xFF8D, "Insert": 0xFF63}

#: Text of the backspace key.
BACKSPACE = "\b"

#: Key and modifier combinations that paste.
_PASTES = {(ord("v"), _CONTROL), (ord("V"), _CONTROL), (_KEYS["Insert"], _SHIFT)}

#: Maximum length of pasted text, bytes.
_MOST = 1 << 16

#: Maximum wait for the program that owns the clipboard, seconds.
_PATIENCE = 0.5


class _KeyEvent(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p),
        *((name, ctypes.c_ulong) for name in ("window", "root", "subwindow", "time")),
        *((name, ctypes.c_int) for name in ("x", "y", "x_root", "y_root")),
        *((name, ctypes.c_uint) for name in ("state", "keycode")),
        ("same_screen", ctypes.c_int),
    )


class _Event(ctypes.Union):
    _fields_ = (("key", _KeyEvent), ("space", ctypes.c_long * 24))


class Pressed(NamedTuple):
    """A key that was pressed.

    Attributes
    ----------
    text : str
        Text that it types, or a backspace; empty if neither.
    enters, pastes : bool
        Whether it is Enter, and whether it pastes.
    """

    text: str
    enters: bool
    pastes: bool


class Keyboard:
    """The keyboard, for this process's window with the focus.

    `listens` is False if that window is unknown, for example without X11.
    """

    def __init__(self) -> None:
        x11 = _library()
        self._display = None if x11 is None else x11.XOpenDisplay(None)
        if x11 is not None:
            self._x11 = x11
        self._window = 0

    @property
    def listens(self) -> bool:
        """Whether a window has the focus and its keys can be read."""
        if self._display and not self._window:
            window = self._focused()
            if window and self._number(window, b"_NET_WM_PID") == os.getpid():
                self._x11.XSelectInput(self._display, window, _KEY_PRESS_MASK)
                self._x11.XSync(self._display, 0)
                self._window = window
        return bool(self._window)

    def close(self) -> None:
        """Close the connection; `listens` is False from then on."""
        if self._display:
            self._x11.XCloseDisplay(self._display)
        self._display, self._window = None, 0

    def pressed(self) -> list[Pressed]:
        """The keys pressed since the last call."""
        if not self.listens:
            return []
        x11, found, event = self._x11, [], _Event()
        x11.XSync(self._display, 0)
        while x11.XPending(self._display):
            x11.XNextEvent(self._display, ctypes.byref(event))
            if event.key.type == _KEY_PRESS and not event.key.send_event:
                found.append(self._decoded(event.key))
        return found

    def _decoded(self, event: _KeyEvent) -> Pressed:
        buffer, symbol = ctypes.create_string_buffer(8), ctypes.c_ulong()
        count = self._x11.XLookupString(
            ctypes.byref(event), buffer, len(buffer), ctypes.byref(symbol), None
        )
        key, state = symbol.value, event.state
        pastes = (key, state & _CONTROL) in _PASTES or (key, state & _SHIFT) in _PASTES
        text = buffer.raw[:count].decode("latin-1")
        enters = key in (_KEYS["Return"], _KEYS["KP_Enter"])
        return Pressed(text if text.isprintable() or text == BACKSPACE else "", enters, pastes)

    def send(self, key: str, down: bool) -> None:
        """Send a press or release of a key in `_KEYS` to the window."""
        if not self.listens:
            return
        x11, event = self._x11, _Event()
        event.key.type = _KEY_PRESS if down else _KEY_RELEASE
        event.key.display, event.key.window = self._display, self._window
        event.key.root, event.key.same_screen = x11.XDefaultRootWindow(self._display), 1
        event.key.keycode = x11.XKeysymToKeycode(self._display, _KEYS[key])
        mask = _KEY_PRESS_MASK if down else _KEY_PRESS_MASK << 1
        x11.XSendEvent(self._display, self._window, 0, mask, ctypes.byref(event))
        x11.XFlush(self._display)

    def _focused(self) -> int:
        """The window with the keyboard focus."""
        x11, window, other = self._x11, ctypes.c_ulong(), ctypes.c_int()
        x11.XGetInputFocus(self._display, ctypes.byref(window), ctypes.byref(other))
        root = x11.XDefaultRootWindow(self._display)
        if window.value not in (_POINTER_ROOT, root):
            return window.value
        # Without a window manager, the window under the pointer.
        names, numbers = [ctypes.c_ulong() for _ in range(2)], [ctypes.c_int() for _ in range(5)]
        x11.XQueryPointer(self._display, root, *map(ctypes.byref, (*names, *numbers)))
        return names[1].value

    def _number(self, window: int, name: bytes) -> int:
        found = self._property(window, name)
        return int.from_bytes(found[:4], sys.byteorder)

    def _property(self, window: int, name: bytes) -> bytes:
        """The value of a window's property; items of 32 bits are returned as C longs."""
        x11 = self._x11
        kind, form, count, left, value = (
            ctypes.c_ulong(), ctypes.c_int(), ctypes.c_ulong(), ctypes.c_ulong(), ctypes.c_void_p(),
        )  # fmt: skip
        atom = x11.XInternAtom(self._display, name, 0)
        found = (kind, form, count, left, value)
        x11.XGetWindowProperty(
            self._display, window, atom, 0, _MOST // 4, 0, 0, *map(ctypes.byref, found)
        )
        if not value.value:
            return b""
        size = {8: 1, 16: 2, 32: ctypes.sizeof(ctypes.c_long)}.get(form.value, 0)
        data = ctypes.string_at(value.value, count.value * size)
        x11.XFree(value)
        return data

    def clipboard(self) -> str:
        """The text in the clipboard; empty if none."""
        if not self._display:
            return ""
        x11, event = self._x11, _Event()
        root = x11.XDefaultRootWindow(self._display)
        window = x11.XCreateSimpleWindow(self._display, root, 0, 0, 1, 1, 0, 0, 0)
        names = (b"CLIPBOARD", b"UTF8_STRING", b"GS_CODEC")
        atoms = [x11.XInternAtom(self._display, name, 0) for name in names]
        x11.XConvertSelection(self._display, *atoms, window, 0)
        end, text = time.monotonic() + _PATIENCE, b""
        while time.monotonic() < end:
            if x11.XCheckTypedWindowEvent(self._display, window, _SELECTION, ctypes.byref(event)):
                text = self._property(window, names[2])
                break
            time.sleep(0.005)
        x11.XDestroyWindow(self._display, window)
        return text.decode("utf-8", "replace")


@functools.cache
def _library() -> ctypes.CDLL | None:
    """Xlib; None if windows do not use X11."""
    name = ctypes.util.find_library("X11") if sys.platform.startswith("linux") else None
    if name is None:
        return None
    x11 = ctypes.CDLL(name)
    number, pointer = ctypes.c_ulong, ctypes.c_void_p
    signatures: dict[str, tuple[type, ...]] = {
        "XOpenDisplay": (pointer, ctypes.c_char_p),
        "XCloseDisplay": (ctypes.c_int, pointer),
        "XDefaultRootWindow": (number, pointer),
        "XSelectInput": (ctypes.c_int, pointer, number, ctypes.c_long),
        "XSync": (ctypes.c_int, pointer, ctypes.c_int),
        "XFlush": (ctypes.c_int, pointer),
        "XPending": (ctypes.c_int, pointer),
        "XNextEvent": (ctypes.c_int, pointer, pointer),
        "XKeysymToKeycode": (ctypes.c_ubyte, pointer, number),
        "XInternAtom": (number, pointer, ctypes.c_char_p, ctypes.c_int),
        "XCreateSimpleWindow": (number, pointer, number, *[ctypes.c_int] * 2, *[ctypes.c_uint] * 3,
                                number, number),
        "XDestroyWindow": (ctypes.c_int, pointer, number),
        "XConvertSelection": (ctypes.c_int, pointer, *[number] * 5),
        "XCheckTypedWindowEvent": (ctypes.c_int, pointer, number, ctypes.c_int, pointer),
        "XGetInputFocus": (ctypes.c_int, pointer, pointer, pointer),
        "XQueryPointer": (ctypes.c_int, pointer, number, *[pointer] * 7),
        "XSendEvent": (ctypes.c_int, pointer, number, ctypes.c_int, ctypes.c_long, pointer),
        "XLookupString": (ctypes.c_int, pointer, ctypes.c_char_p, ctypes.c_int, pointer, pointer),
        "XGetWindowProperty": (ctypes.c_int, pointer, number, number, ctypes.c_long, ctypes.c_long,
                               ctypes.c_int, number, *[pointer] * 5),
        "XFree": (ctypes.c_int, pointer),
    }  # fmt: skip
    for each, (result, *arguments) in signatures.items():
        function = getattr(x11, each)
        function.restype, function.argtypes = result, arguments
    return x11
