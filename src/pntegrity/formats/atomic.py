"""Output files that are whole or not there at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pntegrity.errors import InputError

__all__ = ["atomically", "write_text"]


@contextmanager
def atomically(path: Path | str) -> Iterator[Path]:
    """Give a temporary path in the same folder, renamed to `path` at the end and removed after an error.

    Raises
    ------
    InputError
        Where the folder cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be written: {reason}", path=path, hint="Choose another folder") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: Path | str, text: str, encoding: str = "utf-8") -> None:
    """Write `text` to `path` so that a reader sees the old file or the new one, never a part."""
    with atomically(path) as temporary:
        temporary.write_text(text, encoding=encoding, errors="replace", newline="\n")
