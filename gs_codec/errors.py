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
    """A scene, file or option that cannot be used.

    Examples
    --------
    >>> gs_codec.Config("best")
    Traceback (most recent call last):
        ...
    gs_codec.errors.InvalidInput: profile 'best': expected one of l, m, s, paper-l, paper-m, ...
    """


class CorruptStream(GsCodecError):
    """An `.egs` stream with inconsistent contents or wrong checksums.

    Examples
    --------
    >>> from pathlib import Path
    >>> data = bytearray(Path("scene.egs").read_bytes())
    >>> data[-100] ^= 1
    >>> gs_codec.decode(data)
    Traceback (most recent call last):
        ...
    gs_codec.errors.CorruptStream: section ... checksum does not match
    """


class TruncatedStream(GsCodecError):
    """An `.egs` stream that is shorter than its header states.

    Examples
    --------
    >>> from pathlib import Path
    >>> gs_codec.decode(Path("scene.egs").read_bytes()[:5])
    Traceback (most recent call last):
        ...
    gs_codec.errors.TruncatedStream: header: 5 bytes left at 0, expected 16
    """


class UnsupportedVersion(GsCodecError):
    """An `.egs` stream of a later format version, or with unknown features.

    Examples
    --------
    >>> from pathlib import Path
    >>> data = bytearray(Path("scene.egs").read_bytes())
    >>> data[8] = 9
    >>> gs_codec.decode(data)
    Traceback (most recent call last):
        ...
    gs_codec.errors.UnsupportedVersion: version 9 of the format, this reader knows 1 and 2
    """


class MissingTool(GsCodecError):
    """A required optional program or package is not installed.

    Examples
    --------
    >>> gs_codec.encode("scene.ply", gs_codec.Config("paper-m", geometry="gpcc", tmc3="./tmc3"))
    Traceback (most recent call last):
        ...
    gs_codec.errors.MissingTool: ./tmc3: no such program; tmc3 is MPEG's reference software ...
    """


class ToolFailed(GsCodecError):
    r"""An external program failed.

    Examples
    --------
    >>> from pathlib import Path
    >>> program = Path("failing-tmc3")  # prints its name, and fails when it should encode
    >>> _ = program.write_text("#!/bin/sh\n[ $1 = --help ] && echo tmc3\n")
    >>> program.chmod(0o755)
    >>> config = gs_codec.Config("paper-m", geometry="gpcc", tmc3="./failing-tmc3")
    >>> gs_codec.encode("scene.ply", config)
    Traceback (most recent call last):
        ...
    gs_codec.errors.ToolFailed: gpcc of block 0: tmc3 (tmc3) ended with status 1
    """


def one_line(error: BaseException) -> str:
    """The message of an exception, as one printable line."""
    return printable(" ".join((getattr(error, "strerror", None) or str(error)).split()))
