"""Everything that can go wrong, as one small family of exceptions."""


def printable(text: str) -> str:
    """Text in which characters are escaped that end a line, steer a terminal or turn directions.

    Names in files of strangers may hold any.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class GsCodecError(Exception):
    """Base of every error gs_codec raises on purpose; its text is one printable line.

    Examples
    --------
    >>> try:
    ...     gs_codec.read("missing.ply")
    ... except gs_codec.GsCodecError as error:
    ...     print(error)
    missing.ply: No such file or directory
    """

    #: Whether it is about another file than the one that is worked on, which its text names.
    of_another_file = False

    def __init__(self, text: str = "") -> None:
        super().__init__(printable(text))


class InvalidInput(GsCodecError):
    """A scene, file, or option that cannot be used as given."""


class CorruptStream(GsCodecError):
    """A `.egs` stream whose bytes contradict themselves or their checksums."""


class TruncatedStream(GsCodecError):
    """A `.egs` stream that ends before its header says it does."""


class UnsupportedVersion(GsCodecError):
    """A `.egs` stream written by a later version of the format."""


class MissingTool(GsCodecError):
    """An optional program or package that the request needs is not installed."""


class ToolFailed(GsCodecError):
    """A program of others that was started did not do what it was asked to."""


def one_line(error: BaseException) -> str:
    """What an exception says, on one printable line."""
    return printable(" ".join((getattr(error, "strerror", None) or str(error)).split()))
