"""Find a device that can draw a window; without one, Open3D would end the process."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
from typing import Literal

import gs_codec

#: VkPhysicalDeviceType of a device that is a CPU.
_CPU = 4

#: Byte offset of the type in VkPhysicalDeviceProperties.
_TYPE_AT = 16

#: Size of a buffer larger than this structure.
_PROPERTIES = 4096


class NoDisplay(gs_codec.GsCodecError):
    """No display for a window, or no device to draw it."""


def find_device() -> Literal["gpu", "cpu"]:
    """Find out whether a graphics card or software draws windows.

    Raises
    ------
    NoDisplay
        If no window can be opened.
    """
    if not sys.platform.startswith("linux"):
        return "gpu"
    if not _display_opens():
        shown = os.environ.get("DISPLAY")
        raise NoDisplay(
            f"display {shown}: cannot be opened"
            if shown
            else "no display: DISPLAY is not set; "
            "--screenshot, --turntable, --flythrough and --web need none"
        )
    types = _vulkan_devices()
    if not types:
        raise NoDisplay("no Vulkan device: install a driver, such as mesa-vulkan-drivers")
    return "gpu" if any(kind != _CPU for kind in types) else "cpu"


def _display_opens() -> bool:
    name = ctypes.util.find_library("X11")
    if not os.environ.get("DISPLAY") or name is None:
        return False
    x11 = ctypes.CDLL(name)
    x11.XOpenDisplay.restype = ctypes.c_void_p
    display = x11.XOpenDisplay(None)
    if not display:
        return False
    x11.XCloseDisplay(ctypes.c_void_p(display))
    return True


class _InstanceCreateInfo(ctypes.Structure):
    _fields_ = (
        ("s_type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("layer_count", ctypes.c_uint32),
        ("layers", ctypes.c_void_p),
        ("extension_count", ctypes.c_uint32),
        ("extensions", ctypes.c_void_p),
    )


def _vulkan_devices() -> list[int]:
    """The types of all devices that Vulkan finds."""
    name = ctypes.util.find_library("vulkan")
    if name is None:
        return []
    vulkan = ctypes.CDLL(name)
    instance = ctypes.c_void_p()
    # The structure's type, VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO, is 1.
    info = _InstanceCreateInfo(1)
    if vulkan.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        return []
    count = ctypes.c_uint32()
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    devices = (ctypes.c_void_p * count.value)()
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), devices)
    types = []
    for device in devices:
        properties = (ctypes.c_uint8 * _PROPERTIES)()
        vulkan.vkGetPhysicalDeviceProperties(ctypes.c_void_p(device), properties)
        types.append(int.from_bytes(bytes(properties[_TYPE_AT : _TYPE_AT + 4]), sys.byteorder))
    vulkan.vkDestroyInstance(instance, None)
    return types
