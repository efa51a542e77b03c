"""The integrity support message: what may fail how often, and how much risk is allowed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from math import isfinite
from numbers import Real
from types import MappingProxyType
from typing import Any

from pntegrity.states import is_satellite

__all__ = ["CITY", "MESSAGES", "Ism"]

Three = tuple[float, float, float]
SPLIT = (0.25, 0.25, 0.5)


@dataclass(frozen=True)
class Ism:
    """Fault probabilities, the integrity risk and its split, nominal biases and alert limits.

    A probability of a fault is that of its presence at some time within `exposure_s`. Every default has its
    reason on the page "Integrity support message" of the documentation.

    Parameters
    ----------
    p_sat, p_dcb, p_iono_sat, p_user : float
        What adds up to the probability of one satellite: orbit and clock; code biases; its ionosphere
        product, where there are such products; non-line-of-sight reception and unseen cycle slips.
    p_constellation : float
        All satellites of one constellation at once.
    p_trop, p_iono : float
        The troposphere product; all ionosphere products at once.
    p_other : float
        Any other group of rows (a beacon, a source).
    sources : tuple of (str, float)
        Sources with a probability of their own, in place of `p_other`; and sensors of sources, ``"lbl.AP1"``,
        that may fail by themselves (``"lbl.*"``: any of them). Names that never appear do not count.
    satellites : tuple of (str, float)
        Satellites with a probability of their own, in place of the sum above.
    constellations : tuple of (str, float, float)
        Letter, `p_sat` and `p_constellation` of constellations that differ.
    sectors : int
        How many azimuth sectors there are, evenly around; their satellites fail together. 0: none.
    sector_width_deg : float
        Width of each; where it is more than ``360 / sectors`` they overlap.
    p_sector : float
        All satellites of one sector at once.
    together : tuple of (str, tuple of str, float)
        Further groups that fail together: a name, the groups and the probability.
    p_hmi : float
        Integrity risk over the exposure time: an error beyond a protection level and no alert.
    exposure_s : float
    independent_epochs : float
        How many independent epochs the exposure time is worth; 1: the risk is per epoch.
    split : tuple of float
        Shares of the risk east, north, up.
    p_fa : float
        Probability of a false alert, an epoch.
    fa_split : tuple of float
        Its shares east, north, up.
    unmonitored_share : float
        Fault modes are monitored until what is left is at most this share of `p_hmi`.
    max_modes : int
        No more modes than these are monitored.
    b_code_m, b_carrier_m, b_product_m : float
        Nominal biases: bounds of the mean errors of rows without a fault.
    hal_m, val_m : float
        Horizontal and vertical alert limit; inf: none.
    p_emt : float
        The effective monitor threshold is the largest of the modes at least as probable as this.
    noise : tuple of (str, float)
        Fields of the noise model that the message gives, process and measurement sigmas and correlation
        times.

    Raises
    ------
    ValueError
        Naming the field, the value and what is allowed.
    """

    p_sat: float = 1e-5
    p_dcb: float = 0.0
    p_iono_sat: float = 0.0
    p_user: float = 0.0
    p_constellation: float = 0.0
    p_trop: float = 1e-5
    p_iono: float = 1e-5
    p_other: float = 1e-5
    sources: tuple[tuple[str, float], ...] = ()
    satellites: tuple[tuple[str, float], ...] = ()
    constellations: tuple[tuple[str, float, float], ...] = ()
    sectors: int = 0
    sector_width_deg: float = 90.0
    p_sector: float = 0.0
    together: tuple[tuple[str, tuple[str, ...], float], ...] = ()
    p_hmi: float = 1e-7
    exposure_s: float = 3600.0
    independent_epochs: float = 1.0
    split: Three = SPLIT
    p_fa: float = 1e-6
    fa_split: Three = SPLIT
    unmonitored_share: float = 0.8
    max_modes: int = 300
    b_code_m: float = 0.0
    b_carrier_m: float = 0.0
    b_product_m: float = 0.0
    hal_m: float = float("inf")
    val_m: float = float("inf")
    p_emt: float = 1e-5
    noise: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        for name in FAULTS:
            _check(name, getattr(self, name), 0.0, 1.0)
        self._check_groups()
        for name, low, high in OPEN:
            _check(name, getattr(self, name), low, high, inside=True)
        for name, low in FROM:
            _check(name, getattr(self, name), low)
        for name in ("hal_m", "val_m"):
            _check_limit(name, getattr(self, name))
        for name in ("split", "fa_split"):
            _check_shares(name, getattr(self, name))
        _check("unmonitored_share", self.unmonitored_share, 0.0, 1.0)
        _check_whole("max_modes", self.max_modes, 1)
        for name, value in self.noise:
            _check(f"noise.{name}", value, 0.0)

    def _check_groups(self) -> None:
        _check("p_sat + p_dcb + p_iono_sat + p_user", self._of_any(self.p_sat, True), 0.0, 1.0)
        for name, p in self.satellites:
            if not is_satellite(name):
                raise ValueError(f"`satellites` must name satellites such as G05, not {name!r}")
            _check(f"satellites.{name}", p, 0.0, 1.0)
        for letter, p_sat, p_all in self.constellations:
            if not re.fullmatch("[A-Z]", letter):
                raise ValueError(f"`constellations` must name a letter such as G, not {letter!r}")
            _check(f"constellations.{letter}.p_sat", p_sat, 0.0, 1.0)
            _check(
                f"constellations.{letter}.p_sat with its other causes", self._of_any(p_sat, True), 0.0, 1.0
            )
            _check(f"constellations.{letter}.p_constellation", p_all, 0.0, 1.0)
        self._check_sectors()
        for name, p in self.sources:
            _check_source(name, p)
        for one in self.together:
            _check_together(one)
        names = [name for name, _, _ in self.together]
        if len(set(names)) < len(names):
            raise ValueError(f"`together` must have different names, not {names!r}")

    def _check_sectors(self) -> None:
        _check_whole("sectors", self.sectors, 0, 360)
        _check("sector_width_deg", self.sector_width_deg, 0.0, 360.0)
        if self.sectors and self.sectors * self.sector_width_deg < 360.0:
            least = 360.0 / self.sectors
            raise ValueError(
                f"`sector_width_deg` must be at least {least:g} where there are {self.sectors} sectors, "
                f"not {self.sector_width_deg!r}: they would leave gaps"
            )
        if self.sectors and not self.p_sector:
            raise ValueError("`p_sector` must be above 0 where there are `sectors`, not 0")

    def _of_any(self, p_sat: float, products: bool) -> float:
        return p_sat + self.p_dcb + self.p_user + (self.p_iono_sat if products else 0.0)

    def satellite(self, name: str, products: bool = True) -> float:
        """Return the fault probability of a satellite; `products`: it has an ionosphere product."""
        own = dict(self.satellites).get(name)
        return self._of_any(self.constellation(name[0])[0], products) if own is None else own

    def constellation(self, letter: str) -> tuple[float, float]:
        """Return `p_sat` and `p_constellation` of a constellation."""
        for one, p_sat, p_all in self.constellations:
            if one == letter:
                return p_sat, p_all
        return self.p_sat, self.p_constellation

    def source(self, group: str) -> float:
        """Return the fault probability of a group that is no satellite and no product."""
        return dict(self.sources).get(group, self.p_other)

    def sensor(self, name: str) -> float | None:
        """Return that of one sensor of a source (``"lbl.AP1"``); None where it never fails by itself."""
        own = dict(self.sources)
        return own.get(name, own.get(f"{name.partition('.')[0]}.*"))

    @property
    def tells_of_sensors(self) -> bool:
        """Whether anything is said of single sensors of sources."""
        return any("." in name for name, _ in self.sources) or any(
            "." in g for _, own, _ in self.together for g in own
        )

    @property
    def risk(self) -> float:
        """Integrity risk of one epoch."""
        return self.p_hmi / self.independent_epochs

    @property
    def p_unmonitored(self) -> float:
        """Largest probability of all modes that are not monitored, over the exposure time."""
        return self.unmonitored_share * self.p_hmi

    @property
    def false_alerts_per_hour(self) -> float:
        """Rate of false alerts that `p_fa` amounts to with this many independent epochs."""
        return self.p_fa * self.independent_epochs * 3600.0 / self.exposure_s

    def risks(self, unmonitored: float = 0.0) -> Three:
        """Return the risk of one epoch east, north, up, after the probability of unmonitored modes.

        A fault is there or not for the whole exposure time, the noise is new at each independent epoch: what
        is unmonitored comes off `p_hmi`, and the rest is shared by the epochs.
        """
        left = max(self.p_hmi - unmonitored, 0.0) / self.independent_epochs
        east, north, up = self.split
        return east * left, north * left, up * left

    def false_alerts(self) -> Three:
        """Return the probability of a false alert of one epoch east, north, up."""
        east, north, up = self.fa_split
        return east * self.p_fa, north * self.p_fa, up * self.p_fa

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Ism:
        """Return the message that a table (of a TOML file) holds.

        Raises
        ------
        ValueError
            Naming what is unknown, missing or out of range.
        """
        unknown = sorted(set(table) - {f.name for f in fields(cls)})
        if unknown:
            raise ValueError(f"the integrity support message has no field `{unknown[0]}`")
        given: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in table.items()}
        for name in ("sources", "satellites", "noise", "constellations"):
            if name in given:
                given[name] = _pairs(name, given[name])
        if "together" in given:
            given["together"] = _together(given["together"])
        return cls(**given)

    def to_table(self) -> dict[str, Any]:
        """Return what `from_table` reads."""
        out = {f.name: getattr(self, f.name) for f in fields(self)}
        out["split"], out["fa_split"] = list(self.split), list(self.fa_split)
        for name in ("sources", "satellites", "noise"):
            out[name] = dict(out[name])
        out["constellations"] = {c: {"p_sat": p, "p_constellation": q} for c, p, q in self.constellations}
        out["together"] = [{"name": n, "groups": list(g), "probability": p} for n, g, p in self.together]
        return out


#: Checked to lie from 0 to 1.
FAULTS = (
    "p_sat", "p_dcb", "p_iono_sat", "p_user", "p_constellation", "p_sector", "p_trop", "p_iono", "p_other",
)  # fmt: skip
#: Checked to lie above the first and below the second.
OPEN = (("p_hmi", 0.0, 1.0), ("p_fa", 0.0, 0.5), ("p_emt", 0.0, 1.0), ("exposure_s", 0.0, float("inf")))
#: Checked to be finite and at least this.
FROM = (("independent_epochs", 1.0), ("b_code_m", 0.0), ("b_carrier_m", 0.0), ("b_product_m", 0.0))


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)


def _check(name: str, value: Any, low: float, high: float = float("inf"), inside: bool = False) -> None:
    ok = _is_number(value) and (low < value < high if inside else low <= value <= high)
    if ok:
        return
    upper = f" and {'below' if inside else 'at most'} {high:g}" if isfinite(high) else ""
    least = f"{'above' if inside else 'of at least'} {low:g}"
    raise ValueError(f"`{name}` must be a number {least}{upper}, not {value!r}")


def _check_whole(name: str, value: Any, low: int, high: float = float("inf")) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        upper = f" and at most {high:g}" if isfinite(high) else ""
        raise ValueError(f"`{name}` must be a whole number of at least {low}{upper}, not {value!r}")


#: What names a group or event by itself.
TAKEN = re.compile(r"|[A-Z](\d\d)?|az\d{3}|trop|iono|.*[:+].*")


def _check_source(name: Any, p: Any) -> None:
    source, dot, sensor = name.partition(".") if isinstance(name, str) else ("", "", "")
    if TAKEN.fullmatch(source) or ":" in sensor or bool(dot) != bool(sensor):
        raise ValueError(f"`sources` must name sources such as lbl, or sensors such as lbl.AP1, not {name!r}")
    _check(f"sources.{name}", p, 0.0, 1.0)


def _check_together(one: Any) -> None:
    name, groups, p = one
    if not isinstance(name, str) or TAKEN.fullmatch(name):
        raise ValueError(f"`together` must have names of its own, without `:` and `+`, not {name!r}")
    fits = isinstance(groups, tuple) and all(isinstance(g, str) and g and ":" not in g for g in groups)
    if not fits or not groups:
        raise ValueError(f"`together.{name}.groups` must name groups such as G05, not {groups!r}")
    _check(f"together.{name}.probability", p, 0.0, 1.0)


def _check_limit(name: str, value: Any) -> None:
    if value != float("inf") and not (_is_number(value) and value > 0.0):
        raise ValueError(f"`{name}` must be a number above 0, or inf, not {value!r}")


def _check_shares(name: str, shares: Any) -> None:
    fits = isinstance(shares, tuple) and len(shares) == 3 and all(map(_is_number, shares))
    if not fits or min(shares) < 0.0 or abs(sum(shares) - 1.0) > 1e-9:
        raise ValueError(f"`{name}` must be three shares east, north, up that add up to 1, not {shares!r}")


def _pairs(name: str, table: Any) -> tuple[tuple[Any, ...], ...]:
    """Return the rows of a nested table, sorted: equal messages are then equal values."""
    if not isinstance(table, Mapping):
        raise ValueError(f"`{name}` must be a table, not {table!r}")
    if name == "sources":
        table = dict(_flat(table))
    if name != "constellations":
        return tuple(sorted(table.items()))
    return tuple(_constellation(letter, table[letter]) for letter in sorted(table))


def _flat(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield sources and sensors: TOML reads ``lbl.AP1 = 1e-5`` without quotes as a table within a table."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{sensor}", p) for sensor, p in value.items())
        else:
            yield name, value


def _together(rows: Any) -> tuple[tuple[str, tuple[str, ...], float], ...]:
    """Return the rows of `together`, sorted by name."""
    wanted = {"name", "groups", "probability"}
    if not isinstance(rows, (list, tuple)):
        raise ValueError(f"`together` must be a list of tables, not {rows!r}")
    for row in rows:
        if not isinstance(row, Mapping) or set(row) != wanted or not isinstance(row["groups"], (list, tuple)):
            raise ValueError(f"each `together` must hold name, groups and probability, not {row!r}")
    out = [(row["name"], tuple(row["groups"]), row["probability"]) for row in rows]
    return tuple(sorted(out, key=lambda one: str(one[0])))


def _constellation(letter: str, row: Any) -> tuple[str, float, float]:
    wanted = {"p_sat", "p_constellation"}
    if not isinstance(row, Mapping) or set(row) != wanted:
        raise ValueError(f"`constellations.{letter}` must hold p_sat and p_constellation, not {row!r}")
    return letter, row["p_sat"], row["p_constellation"]


CITY = Ism(
    p_sat=1e-5,
    p_user=4e-5,
    p_constellation=1e-4,
    constellations=(("G", 1e-5, 1e-8),),
    sectors=8,
    sector_width_deg=90.0,
    p_sector=1e-4,
    p_hmi=1e-5,
    exposure_s=1.0,
)
"""For streets: satellites, sectors and constellations, at a risk of 1e-5 an epoch.

Up to 50 satellites need no pairs: they stay unmonitored, with a probability below 8e-6. The reasons for each
number are on the page "Integrity support message" of the documentation.
"""

MESSAGES: Mapping[str, Ism] = MappingProxyType({"open": Ism(), "city": CITY})
"""The message that suits a surrounding, where none is given."""
