"""Scene to stream and back. Only this package knows the order of the stages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gs_codec.runtime.lazy import lazy_names

if TYPE_CHECKING:
    from gs_codec.codecs.decode import decode_part, decode_scene
    from gs_codec.codecs.encode import encode_parts, encode_scene

__all__ = ["decode_part", "decode_scene", "encode_parts", "encode_scene"]

_, __getattr__ = lazy_names(
    __name__,
    {
        "gs_codec.codecs.decode": ("decode_part", "decode_scene"),
        "gs_codec.codecs.encode": ("encode_parts", "encode_scene"),
    },
)
