"""All exceptions that gs_codec raises."""


def printable(text: str) -> str:
    """Escape characters that are not printable: line ends, terminal controls, text direction.

    Names in untrusted files may contain them.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class GsCodecError(Exception):
    """Base class of all gs_codec errors; the message is one printable line.

    Examples
    --------
    >>> try:
    ...     gs_codec.read("missing.ply")
    ... except gs_codec.GsCodecError as error:
    ...     print(error)
    missing.ply: No such file or directory
    """

    #: Whether the error concerns a file other than the one being read; the message names that file.
    of_another_file = False

    def __init__(self, text: str = "") -> None:
        super().__init__(printable(text))


class InvalidInput(GsCodecError):
    """A scene, file or option that cannot be used."""


class CorruptStream(GsCodecError):
    """An `.egs` stream with inconsistent contents or wrong checksums."""


class TruncatedStream(GsCodecError):
    """An `.egs` stream that is shorter than its header states."""


class UnsupportedVersion(GsCodecError):
    """An `.egs` stream of a later format version, or with unknown features."""


class MissingTool(GsCodecError):
    """A required optional program or package is not installed."""


class ToolFailed(GsCodecError):
    """An external program failed."""


def one_line(error: BaseException) -> str:
    """The message of an exception, as one printable line."""
    return printable(" ".join((getattr(error, "strerror", None) or str(error)).split()))
