"""The package's own exceptions: each carries what is needed to act on it."""

from __future__ import annotations

from pathlib import Path

__all__ = ["InputError"]


class InputError(ValueError):
    """A file or table that cannot be used.

    Parameters
    ----------
    message : str
        What is wrong, in words.
    path : Path or str, optional
        The file.
    line : int, optional
        Line in the (uncompressed) file, counted from 1.
    epoch : str, optional
        Time tag of the place, ISO format.
    hint : str
        What to do about it.
    """

    def __init__(
        self,
        message: str,
        *,
        path: Path | str | None = None,
        line: int | None = None,
        epoch: str | None = None,
        hint: str = "",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.path = None if path is None else Path(path)
        self.line = line
        self.epoch = epoch
        self.hint = hint

    def __str__(self) -> str:
        where = [] if self.path is None else [str(self.path)]
        if self.line is not None:
            where.append(f"line {self.line}")
        if self.epoch is not None:
            where.append(f"epoch {self.epoch}")
        text = f"{', '.join(where)}: {self.message}" if where else self.message
        return f"{text}. {self.hint}" if self.hint else text

    def __reduce__(self) -> tuple[object, ...]:
        return _restore, (self.message, self.path, self.line, self.epoch, self.hint)


def _restore(message: str, path: Path | None, line: int | None, epoch: str | None, hint: str) -> InputError:
    return InputError(message, path=path, line=line, epoch=epoch, hint=hint)
