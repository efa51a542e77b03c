"""What can still be read of a damaged observation file.

sidereon's reader is strict: one bad line and the file is refused. Here a refused file is cut at its epoch
lines, bad epochs are found by halving, and in RINEX 3 and 4 a bad epoch is tried once more without its bad
satellite lines.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import sidereon

from pntegrity.errors import InputError

__all__ = ["decode_crinex", "parse_observations"]

_EPOCH2 = re.compile(r"^ \d\d [ \d]\d [ \d]\d [ \d]\d [ \d]\d [ \d]\d\.\d{7}  \d", re.MULTILINE)
_EPOCH3 = re.compile(r"^>", re.MULTILINE)
_REFUSED = (sidereon.SidereonError, ValueError)


def parse_observations(text: str, path: Path, notes: list[str]) -> list[Any]:
    """Return sidereon's product of `text`, or those of its readable pieces.

    Raises
    ------
    InputError
        Nothing can be read.
    """
    try:
        return [sidereon.parse_rinex_obs(text)]
    except _REFUSED as error:
        reason = _short(error)
    header, epochs, first_line = _cut(text, path, reason)
    out: list[Any] = []
    bad: Counter[str] = Counter()
    lines = first_line
    _halve(header, epochs, lines, out, bad)
    if not out:
        raise InputError(f"cannot be read ({reason})", path=path, hint="Convert the receiver's log again")
    for what, n in bad.most_common(5):
        notes.append(f"{n} x {what}")
    rest = sum(bad.values()) - sum(n for _, n in bad.most_common(5))
    if rest:
        notes.append(f"{rest} more damaged pieces dropped")
    return out


def _short(error: Exception) -> str:
    return str(error).removeprefix("parse error: ").split(' in "')[0][:120]


def _cut(text: str, path: Path, reason: str) -> tuple[str, list[str], int]:
    """Return header, epochs as texts, and the line number of the first epoch."""
    end = text.find("END OF HEADER")
    if end < 0:
        raise InputError(
            "the header has no end ('END OF HEADER')",
            path=path,
            hint="The file is cut off or not RINEX: get it again",
        )
    body = text.find("\n", end) + 1
    header = text[:body] if body else text + "\n"
    try:
        sidereon.parse_rinex_obs(header)
    except _REFUSED as error:
        raise InputError(
            f"the header cannot be read ({_short(error)})",
            path=path,
            hint="Correct it, or convert the log again",
        ) from None
    pattern = _EPOCH2 if text[:9].strip().startswith(("1", "2")) else _EPOCH3
    at = [m.start() for m in pattern.finditer(text, body)] if body else []
    if not at:
        raise InputError(
            f"no epoch can be read ({reason})", path=path, hint="Convert the receiver's log again"
        )
    return header, [text[i:j] for i, j in zip(at, [*at[1:], len(text)], strict=True)], header.count("\n") + 1


def _halve(header: str, epochs: list[str], line: int, out: list[Any], bad: Counter[str]) -> None:
    """Parse `epochs`; where that fails, each half by itself. `out` stays in the file's order."""
    try:
        out.append(sidereon.parse_rinex_obs(header + "".join(epochs)))
        return
    except _REFUSED as error:
        reason = _short(error)
    if len(epochs) == 1:
        _mend(header, epochs[0], reason, out, bad)
        return
    middle = len(epochs) // 2
    _halve(header, epochs[:middle], line, out, bad)
    _halve(header, epochs[middle:], line, out, bad)


def _mend(header: str, epoch: str, reason: str, out: list[Any], bad: Counter[str]) -> None:
    """Try a bad RINEX 3 epoch without its bad satellite lines."""
    head, *rows = epoch.splitlines()
    good = (
        [r for r in rows if _reads(header, head, [r])] if head.startswith(">") and head[31:32] in "01" else []
    )
    if good and _reads(header, head, good):
        out.append(sidereon.parse_rinex_obs(header + _epoch_text(head, good)))
        missing = max(len(rows) - len(good), 1)
        bad[f"satellite line dropped ({reason})"] += missing
    else:
        bad[f"epoch dropped ({reason})"] += 1


def _epoch_text(head: str, rows: list[str]) -> str:
    return "\n".join([f"{head[:32]}{len(rows):3d}{head[35:]}", *rows, ""])


def _reads(header: str, head: str, rows: list[str]) -> bool:
    try:
        return int(
            sidereon.parse_rinex_obs(header + _epoch_text(head, rows)).epoch(0).satellite_count
        ) == len(rows)
    except (*_REFUSED, IndexError):
        return False


def decode_crinex(text: str, path: Path, notes: list[str]) -> str:
    """Return the RINEX text of a CRINEX file; of a damaged one, the part before the damage.

    Raises
    ------
    InputError
        Not even the first epoch can be decoded.
    """
    lines = text.splitlines(keepends=True)
    reason = _damage(lines)
    if not reason:
        return str(sidereon.decode_crinex(text))
    good, bad = 0, len(lines) + 1
    while bad - good > 1:  # CRINEX holds differences: after a damage nothing can be trusted
        middle = (good + bad) // 2
        good, bad = (middle, bad) if _damage(lines[:middle]) in ("", UNFINISHED) else (good, middle)
    for n in range(good, max(good - 200, 0), -1):  # back to the end of the last whole epoch
        if not _damage(lines[:n]):
            notes.append(f"CRINEX is damaged at or after line {n + 1} ({reason}): what follows is dropped")
            return str(sidereon.decode_crinex("".join(lines[:n])))
    raise InputError(f"the CRINEX file cannot be decoded ({reason})", path=path, hint="Download it again")


UNFINISHED = "the last epoch is cut off"


def _damage(lines: list[str]) -> str:
    """Return what keeps CRINEX lines from being decoded, or an empty string."""
    try:
        sidereon.decode_crinex("".join(lines))
    except _REFUSED as error:
        return UNFINISHED if "truncated" in str(error) else _short(error)
    return ""
