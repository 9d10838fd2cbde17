"""Scene to stream and back: the order of the stages is decided here alone."""

from gs_codec.codecs.decode import decode_part, decode_scene
from gs_codec.codecs.encode import encode_parts, encode_scene

__all__ = ["decode_part", "decode_scene", "encode_parts", "encode_scene"]
