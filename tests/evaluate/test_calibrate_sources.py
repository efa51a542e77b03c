"""The sigmas of a vehicle's sources are found, also where the first part of the log has a fault in it."""

from __future__ import annotations

from dataclasses import fields, replace
from io import StringIO
from math import isnan

import numpy as np
import pytest
from rich.console import Console

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.evaluate.calibrate_sources import SourceCalibration, calibrate_sources
from pntegrity.evaluate.calibration_table import source_facts, source_table
from pntegrity.monitors import discover
from pntegrity.scenarios._vessel_logs import estimator
from pntegrity.scenarios.vessel import simulated_vessel
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.vehicle import types

#: What is given, in units of the truth.
WRONG = {"gnss.sigma_m": 2.0, "lbl.sigma_s": 0.4, "usbl.sigma_s": 3.0, "usbl.sigma_angle_deg": 0.3,
         "depth.sigma_m": 0.5}  # fmt: skip
FAULT = "lbl.AP1 ramp 0.8 ms/s 50:65"
SECONDS = 215


@pytest.fixture(scope="module")
def ship():
    """A short simulated ship: its epochs and the options of its filter."""
    made = simulated_vessel(SECONDS, 1.0, 20.0, 7)
    return made.log.epochs, estimator(made.log, made.ship.spec).options


def sigma(options: GnssOptions, name: str) -> float:
    source, _, field = name.partition(".")
    return next(getattr(s, field) for s in options.sources if s.name == source)


def wrong(options: GnssOptions, factors: dict[str, float]) -> GnssOptions:
    """Return options whose sigmas are off by factors."""
    sources = []
    for s in options.sources:
        own = {n.partition(".")[2]: f for n, f in factors.items() if n.partition(".")[0] == s.name}
        sources.append(replace(s, **{k: f * getattr(s, k) for k, f in own.items()}))
    return replace(options, sources=tuple(sources))


def monitors():
    """Return the monitors that name who is at fault."""
    return [discover()["source_separation"](1e-6, longest=40), discover()["sensor_window"](1e-6)]


@pytest.fixture(scope="module")
def found(ship) -> SourceCalibration:
    """What comes of wrong sigmas and a beacon that is at fault for 15 of the first 107 s."""
    epochs, options = ship
    faulty = apply_faults(epochs, [parse_fault(FAULT)])
    return calibrate_sources(faulty, wrong(options, WRONG), monitors())


def by_name(result: SourceCalibration):
    return {f"{s.source}.{s.field}": s for s in result.sigmas}


@pytest.mark.parametrize("name", list(WRONG))
def test_true_sigmas_are_found_though_a_beacon_was_at_fault(ship, found, name):
    truth, one = sigma(ship[1], name), by_name(found)[name]
    assert one.given == pytest.approx(WRONG[name] * truth)
    assert one.likely == pytest.approx(truth, rel=0.2)
    assert one.fitted == pytest.approx(truth, rel=0.2)
    # AND how sure it is of that is said
    assert abs(np.log(one.likely / truth)) < 4.0 * one.error < 0.5
    # AND the rest of the log agrees with the fitted one, not with the given
    assert one.ratio_fitted == pytest.approx(1.0, abs=0.2)
    assert abs(np.log(one.ratio_given)) > abs(np.log(one.ratio_fitted))


def test_the_fault_was_left_out_and_nothing_alarms_afterwards(found):
    assert 15 <= found.left_out["lbl.AP1"] < 30
    assert set(found.left_out) == {"lbl.AP1"}
    assert found.fitted.alarms == {"source_separation": 0, "sensor_window": 0}
    assert found.fitted.left_out == {}
    assert found.gain > 1.0
    # AND innovations are unit ones, as far as so many of them and the fit can be
    for source in ("gnss", "lbl", "usbl", "depth"):
        own = found.fitted.whiteness[source]
        error = max(s.error for s in found.sigmas if s.source == source and not s.reason)
        spread = np.sqrt(2.0 / own["count"] + (2.0 * error) ** 2)
        assert own["mean_square"] == pytest.approx(1.0, abs=4.0 * spread)


def test_what_the_log_cannot_show_stays_and_is_said(ship, found):
    # GIVEN no range rates, and directions and times of the transponder but no ranges
    stays = {n for n, s in by_name(found).items() if s.reason}
    assert stays == {"gnss.sigma_mps", "usbl.sigma_range_m"}
    for name in stays:
        one = by_name(found)[name]
        assert one.fitted == one.given == sigma(ship[1], name)
        assert isnan(one.error)
    assert set(found.tables()) == {"gnss", "lbl", "usbl", "depth"}
    assert set(found.tables()["usbl"]) == {"sigma_s", "sigma_angle_deg"}
    out = StringIO()
    Console(file=out, width=140).print(source_table(found))
    text = out.getvalue()
    assert "usbl sigma_range_m stays: no row depends on it" in text
    assert "fitted on 107 epochs" in text
    assert "lbl.AP1" in text
    # AND that a smaller sigma of a receiver is not that of its slow errors
    assert [n for n, s in by_name(found).items() if s.caution] == ["gnss.sigma_m"]
    assert "gnss sigma_m: smaller than given" in text
    facts = source_facts(found)["sigma"]["lbl.sigma_s"]
    assert facts["likely"] == pytest.approx(by_name(found)["lbl.sigma_s"].likely, rel=1e-3)


def test_what_is_put_back_is_not_made_up_for_by_the_others():
    # GIVEN pseudoranges whose slow errors are said to be 1 m where there are none: beside the others the log
    # does not tell how much smaller they are
    made = simulated_vessel(205, 1.0, 20.0, 3)
    options = estimator(made.log, made.ship.spec).options
    gnss = replace(options.sources[0], slow_sigma_m=1.0)
    epochs = [replace(e, observations=(e.sensor("gnss"),)) for e in made.log.epochs]
    found = by_name(calibrate_sources(epochs, replace(options, sources=(gnss,)), ()))
    assert found["gnss.slow_sigma_m"].reason
    assert found["gnss.slow_sigma_m"].fitted == 1.0
    # THEN the two together are as large as errors are
    assert found["gnss.sigma_m"].fitted < 0.95 * options.sources[0].sigma_m
    assert found["gnss.sigma_m"].ratio_fitted == pytest.approx(1.0, abs=0.1)


def test_a_vehicle_with_nothing_to_fit_and_too_short_a_log_are_refused(ship):
    epochs, options = ship
    with pytest.raises(InputError, match="100 epochs"):
        calibrate_sources(epochs[:150], options, ())

    class Told:
        name = "told"

    with pytest.raises(InputError, match="no source has a sigma"):
        calibrate_sources(epochs, replace(options, sources=(Told(),)), ())


@pytest.mark.parametrize("kind", sorted(types()))
def test_every_type_of_source_says_what_can_be_fitted(kind):
    cls = types()[kind]
    known = {f.name: f.default for f in fields(cls)}
    assert cls.fitted
    for name in cls.fitted:
        assert known[name] > 0.0
