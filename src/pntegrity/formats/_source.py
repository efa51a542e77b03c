"""Bytes of a file, plain or gzip, with errors that say what to do."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from pntegrity.errors import InputError

__all__ = ["read_bytes", "read_text", "with_decimal_version", "without_cut_line"]

GZIP_MAGIC = b"\x1f\x8b"
#: What some programs begin a file with to say that it is UTF-8.
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
OTHER_ARCHIVES = {
    b"\x1f\x9d": "a Unix compress (.Z) file",
    b"PK\x03\x04": "a zip archive",
    b"BZh": "a bzip2 file",
    b"\xfd7zXZ": "an xz file",
}
# Every byte that is no printable ASCII becomes "?", so columns stay where they are.
_ASCII = bytes(b if 32 <= b < 127 or b in b"\t\n\r" else ord("?") for b in range(256))


def read_bytes(path: Path | str) -> bytes:
    """Return the content of `path`, decompressed where it is gzip (told by its first bytes, not by its name).

    Raises
    ------
    InputError
        Missing, unreadable, a directory, empty, or a damaged gzip file.
    """
    path = Path(path)
    data = _raw(path)
    if data.startswith(GZIP_MAGIC):
        data = _gunzip(path, data)
    if not data.strip():
        raise InputError("the file is empty", path=path, hint="Download or log it again")
    for magic, what in OTHER_ARCHIVES.items():
        if data.startswith(magic):
            raise InputError(f"this is {what}", path=path, hint="Unpack it first (gzip is read as it is)")
    return data


def _raw(path: Path) -> bytes:
    if path.is_dir():
        raise InputError("this is a directory", path=path, hint="Name one file in it")
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", path=path, hint="Check the path") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read ({error})", path=path, hint="Check the path and its permissions"
        ) from None


def _gunzip(path: Path, data: bytes) -> bytes:
    try:
        return gzip.decompress(data)
    except EOFError:
        raise InputError(
            "the gzip file is cut off", path=path, hint="Copy or download it again (gzip -t tests it)"
        ) from None
    except (OSError, zlib.error) as error:
        raise InputError(f"the gzip file is damaged ({error})", path=path, hint="Download it again") from None


def read_text(path: Path | str) -> str:
    """Return the content of `path` as ASCII text, each foreign byte replaced by ``?``.

    Raises
    ------
    InputError
        As `read_bytes`, and where the content is binary.
    """
    data = read_bytes(path).removeprefix(BYTE_ORDER_MARK)
    if _is_binary(data):
        raise InputError(
            "this is a binary file, text was expected",
            path=path,
            hint="Convert a receiver's raw log to RINEX first, with RTKLIB's convbin or the maker's own tool",
        )
    return data.translate(_ASCII).decode("ascii")


def _is_binary(data: bytes, sample: int = 8192) -> bool:
    head = data[:sample]
    odd = len(head) - len(head.translate(None, _ODD))
    return b"\0" in head or odd > 0.1 * len(head)


_ODD = bytes(b for b in range(256) if not (32 <= b < 127 or b in b"\t\n\r"))


def rinex_first_line(text: str, path: Path, hint: str) -> str:
    """Return the first line of a RINEX file.

    Raises
    ------
    InputError
        Where it is none; `hint` tells what to give instead.
    """
    first = text[:81].split("\n", 1)[0]
    if "RINEX VERSION / TYPE" not in first:
        raise InputError(
            "this is not a RINEX file (its first line lacks 'RINEX VERSION / TYPE')",
            path=path,
            line=1,
            hint=hint,
        )
    return first


def with_decimal_version(text: str) -> str:
    """Return RINEX text whose version has decimals: sidereon refuses ``2`` for ``2.00``."""
    version = text[:20].split()
    if version and version[0].isdigit():
        return f"{float(version[0]):9.2f}" + text[9:]
    return text


def without_cut_line(text: str, notes: list[str]) -> str:
    """Return text less a last line without a line end: in a file that is cut off its last number is wrong."""
    if text.endswith("\n") or "\n" not in text:
        return text
    notes.append("the last line has no line end and may be cut off: dropped")
    return text[: text.rindex("\n") + 1]
