"""The configuration of a run: what the command line's options and ``--config run.toml`` hold, checked in one
place.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from pntegrity.bounds.ism import MESSAGES, Ism
from pntegrity.errors import InputError
from pntegrity.estimators import discover as discover_estimators
from pntegrity.inertial import VEHICLE, InertialConfig, usual_monitors
from pntegrity.monitors import discover
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.faults import parse_fault
from pntegrity.vehicle import check_names, priors_of, with_fields

__all__ = [
    "RunConfig",
    "has_option",
    "load_toml",
    "make_config",
    "make_monitor",
    "noise_of",
    "read_ism",
    "read_noise",
    "to_toml",
    "write_noise",
]

Metres = Annotated[float, Field(allow_inf_nan=False)]


class RunConfig(InertialConfig):
    """Everything that decides what a run computes.

    Files are as given on the command line; `faults` are in the grammar of ``simulate.faults``; `noise` is a
    table of fields of `NoiseModel`, or a file that ``calibrate`` wrote, whose table ``sources`` has fields of
    sources that win over theirs; `ism` is the integrity support
    message, a table of fields of `Ism`, whose own ``noise`` table wins. `monitors` are those that suit the
    estimator where none is named. `monitor` holds options of single
    monitors, for instance ``[monitor.aime] window = 10``. Fields of the inertial side are those of
    `InertialConfig`.
    """

    obs: Path | None = None
    nav: tuple[Path, ...] = ()
    sp3: tuple[Path, ...] = ()
    clk: tuple[Path, ...] = ()
    bias: tuple[Path, ...] = ()
    antex: tuple[Path, ...] = ()
    blq: Path | None = None
    erp: Path | None = None
    station: str = ""
    atmosphere: Path | None = None
    clas: tuple[Path, ...] = ()
    clas_grid: Path | None = None
    estimator: str = "spp_kf"
    monitors: tuple[str, ...] = ()
    variant: Literal["exact", "published"] = "exact"
    p_fa: float = Field(1e-6, gt=0.0, lt=0.5)
    exclude: bool = True
    mask_deg: float = Field(10.0, ge=0.0, lt=90.0)
    systems: str = Field("GREC", min_length=1, pattern="^[GRECJ]+$")
    doppler: bool = True
    ionosphere_free: bool = False
    motion: Literal["white", "walk", "velocity", "static"] = "white"
    truth_ecef_m: tuple[Metres, Metres, Metres] | None = None
    truth: Path | None = None
    faults: tuple[str, ...] = ()
    start: str | None = None
    end: str | None = None
    noise: dict[str, Any] = Field(default_factory=dict)
    ism: dict[str, Any] = Field(default_factory=dict)
    monitor: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @field_validator("estimator")
    @classmethod
    def _is_estimator(cls, name: str) -> str:
        if name not in discover_estimators():
            raise ValueError(
                f"no estimator is called {name!r}; there are {', '.join(sorted(discover_estimators()))}"
            )
        return name

    @field_validator("faults")
    @classmethod
    def _are_faults(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            try:
                parse_fault(text)
            except ValueError as error:
                why = str(error).partition("\n")[0]
                raise ValueError(f"{why}; write it like 'G05 ramp 0.1 m/s 200:300'") from None
        return texts

    @model_validator(mode="before")
    @classmethod
    def _noise_of_sources(cls, values: Any) -> Any:
        noise = values.get("noise") if isinstance(values, dict) else None
        if not isinstance(noise, dict) or "sources" not in noise:
            return values
        rest = {k: v for k, v in noise.items() if k != "sources"}
        return {**values, "noise": rest, "source": with_fields(values.get("source", ()), noise["sources"])}

    @model_validator(mode="before")
    @classmethod
    def _usual_monitors(cls, values: Any) -> Any:
        if not isinstance(values, dict) or "monitors" in values:
            return values
        name = str(values.get("estimator", "spp_kf"))
        known = discover_estimators().get(name)
        return (
            values
            if known is None
            else {**values, "monitors": usual_monitors(name, values) or known.monitors}
        )

    @field_validator("monitors")
    @classmethod
    def _known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names:
            raise ValueError(f"name at least one monitor of {', '.join(sorted(discover()))}")
        for name in names:
            if name not in discover():
                raise ValueError(f"no monitor is called {name!r}; there are {', '.join(sorted(discover()))}")
        return tuple(dict.fromkeys(names))

    @model_validator(mode="after")
    def _consistent(self) -> RunConfig:
        if self.truth is not None and self.truth_ecef_m is not None:
            raise ValueError("give `truth` or `truth_ecef_m`, not both")
        for name in self.monitor:
            if name not in discover():
                raise ValueError(f"[monitor.{name}]: no monitor is called {name!r}")
        given = [name for name in ("clk", "bias", "antex", "blq", "erp") if getattr(self, name)]
        if given and not self.sp3:
            raise ValueError(f"`{given[0]}` goes with precise orbits: give them with --sp3")
        self._check_corrections()
        self._check_sources()
        self.check_inertial(self.estimator)
        self.noise_model()
        self.build_monitors()
        return self

    def _check_sources(self) -> None:
        """Refuse too few and too many files to start from."""
        if self.fixes is not None or self.source:
            given = [name for name in ("obs", "nav", "sp3") if getattr(self, name)]
            if given:
                raise ValueError(f"give `{'source' if self.source else 'fixes'}` or `{given[0]}`, not both")
            return
        if self.obs is None and self.estimator == VEHICLE:
            return  # what is missing then is said with the rest of the vehicle
        if self.obs is None:
            raise ValueError("give observations (--obs), or with --estimator gnss_ins fixes (--fixes)")
        if not self.nav and not self.sp3:
            raise ValueError("give navigation files (--nav), or precise orbits (--sp3)")

    def _check_corrections(self) -> None:
        """Refuse corrections that nothing would use."""
        given = [name for name in ("atmosphere", "clas") if getattr(self, name)]
        if given and discover_estimators()[self.estimator].bands != "apart":
            raise ValueError(f"`{given[0]}` goes with --estimator ppp_rtk, not {self.estimator}")
        if self.clas and self.sp3:
            raise ValueError("`clas` corrects broadcast ephemerides: give it without --sp3")
        if self.clas and not self.nav:
            raise ValueError("`clas` corrects broadcast ephemerides: give them with --nav")
        if len(given) > 1:
            raise ValueError("`clas` has delays of the atmosphere already: give it without --atmosphere")

    def noise_model(self) -> NoiseModel:
        """Return the noise model: that of the estimator, where nothing else is given."""
        model = noise_of(self.noise, discover_estimators()[self.estimator].default_noise)
        stated = dict(self.ism_model().noise)
        return noise_of(stated, model) if stated else model

    def ism_model(self) -> Ism:
        """Return the integrity support message: that of the estimator's surroundings, where nothing else is
        given; its false-alert probability is `p_fa`, and priors are those of the sources, where it has none.
        """
        usual = MESSAGES[discover_estimators()[self.estimator].surroundings].to_table()
        stated = dict(self.ism.get("sources", {}))
        check_names(self.source, stated)
        priors = priors_of(self.source) | stated
        given = self.ism | ({"sources": priors} if priors else {})
        return Ism.from_table(usual | {"p_fa": self.p_fa} | given)

    def build_monitors(self, p_fa: float | None = None, noise: NoiseModel | None = None) -> tuple[Any, ...]:
        """Return the monitors, each with its calibrated threshold factor and its own options."""
        model, ism = noise or self.noise_model(), self.ism_model()
        usual = discover_estimators()[self.estimator].monitoring
        return tuple(
            make_monitor(
                n,
                p_fa or (ism.p_fa if has_option(n, "ism") else self.p_fa),
                self.variant,
                model,
                ({"ism": ism} if has_option(n, "ism") else {}) | usual.get(n, {}) | self.monitor.get(n, {}),
            )
            for n in self.monitors
        )


def has_option(monitor: str, option: str) -> bool:
    """Tell whether a monitor has an option."""
    return option in (f.name for f in fields(discover()[monitor]))


def noise_of(table: dict[str, Any], default: NoiseModel | None = None) -> NoiseModel:
    """Return the noise model of a ``[noise]`` table; what it does not say is that of `default`.

    Raises
    ------
    ValueError
        Naming a field that is unknown or out of range.
    """
    values = dict(table)
    try:
        factors = tuple(sorted((str(k), float(v)) for k, v in dict(values.pop("factors", {})).items()))
        satellites = tuple(
            sorted((str(k), float(a), float(b)) for k, (a, b) in dict(values.pop("satellites", {})).items())
        )
    except (TypeError, ValueError):
        raise ValueError("noise model: `factors` must be numbers, `satellites` pairs of numbers") from None
    unknown = set(values) - set(NoiseModel.__dataclass_fields__)
    if unknown:
        raise ValueError(f"noise model: unknown field {sorted(unknown)[0]!r}")
    return replace(default or NoiseModel(), **values, factors=factors, satellites=satellites)


def make_monitor(
    name: str,
    p_fa: float,
    variant: str = "exact",
    noise: NoiseModel | None = None,
    options: dict[str, Any] | None = None,
) -> Any:
    """Return one monitor; a monitor that has no published variant stays exact.

    Raises
    ------
    ValueError
        Where an option is unknown or out of range.
    """
    cls = discover()[name]
    values: dict[str, Any] = {"p_fa": p_fa, "factor": (noise or NoiseModel()).factor(name)}
    if "published" in str(cls.__annotations__.get("variant", "")):
        values["variant"] = variant
    known = [f.name for f in fields(cls)]
    unknown = sorted(set(options or {}) - set(known))
    if unknown:
        raise ValueError(f"monitor {name} has no option {unknown[0]!r}; it has {', '.join(known)}")
    try:
        return cls(**(values | (options or {})))
    except ValueError as error:
        raise ValueError(f"monitor {name}: {error}") from None


def load_toml(path: Path, hint: str = "docs/formats/config.md has an example") -> dict[str, Any]:
    """Return the tables of a TOML file; `hint` tells where one is shown.

    Raises
    ------
    InputError
        Where the file cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"is not TOML: {error}", path=path, hint=hint) from error


def make_config(values: dict[str, Any]) -> RunConfig:
    """Return a checked configuration.

    Raises
    ------
    InputError
        Naming the field, the value and what is allowed.
    """
    try:
        return RunConfig(**values)
    except ValidationError as error:
        for found in error.errors():
            why = found.get("ctx", {}).get("error")
            if isinstance(why, InputError):  # of a file: it names file, line and what to do
                raise why from None
        why = "; ".join(_in_words(dict(e)) for e in error.errors())
        raise InputError(why, hint="`pntegrity run --help` lists the options") from None


def _in_words(error: dict[str, Any]) -> str:
    """Return what pydantic found: the field, what is wrong, and the value where the text does not have it."""
    where = ".".join(str(p) for p in error["loc"])
    if error["type"] == "extra_forbidden":
        near = get_close_matches(where, RunConfig.model_fields, 1)
        meant = f": `{near[0]}` is one" if near else ""
        return f"`{where}` is no field of a configuration{meant} (docs/formats/config.md lists them)"
    if error["type"] == "value_error":
        return f"{where}: {error['ctx']['error']}" if where else str(error["ctx"]["error"])
    return f"{where}: {error['msg']}, not {error['input']!r}"


def read_noise(path: Path) -> dict[str, Any]:
    """Return the noise table of a file that ``calibrate`` wrote."""
    tables = load_toml(path)
    if "noise" not in tables:
        raise InputError("has no [noise] table", path=path, hint="Write one with `pntegrity calibrate`")
    return dict(tables["noise"])


def read_ism(path: Path) -> dict[str, Any]:
    """Return the table of a file with an integrity support message.

    Raises
    ------
    InputError
        Where it cannot be read, or something in it cannot be.
    """
    hint = "docs/formats/ism.md has an example"
    table = load_toml(path, hint)
    try:
        Ism.from_table(table)
    except ValueError as error:
        raise InputError(str(error), path=path, hint=hint) from None
    return table


def write_noise(noise: NoiseModel, facts: dict[str, Any]) -> str:
    """Return the text of a noise file: the model as ``[noise]`` and how it was found as ``[calibration]``."""
    values = {
        n: getattr(noise, n) for n in NoiseModel.__dataclass_fields__ if n not in ("factors", "satellites")
    }
    satellites = {sat: [round(code, 3), round(rate, 3)] for sat, code, rate in noise.satellites}
    return to_toml(
        {"noise": values | {"factors": dict(noise.factors), "satellites": satellites}, "calibration": facts}
    )


def to_toml(tables: dict[str, Any], prefix: str = "") -> str:
    """Return nested tables of plain values as TOML; None is left out."""
    plain = {k: v for k, v in tables.items() if v is not None and not isinstance(v, dict)}
    nested = {k: v for k, v in tables.items() if isinstance(v, dict)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    text = "\n".join(lines) + ("\n" if lines else "")
    for k, v in nested.items():
        name = f"{prefix}{_key(k)}"
        text += f"\n[{name}]\n{to_toml(v, name + '.')}"
    return text


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "nan"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    return json.dumps(str(value))
