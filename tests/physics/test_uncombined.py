"""Epochs of each band apart: they are the parts of the combined ones, on a real log."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.formats.products import ProductFiles
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.logs import precise_log
from pntegrity.physics.precise_epochs import _against_combination, _biases
from pntegrity.physics.products import CodeBiases
from pntegrity.physics.signals import CLOCK_SIGNALS, frequency_hz

SPAN_S = 1800


@pytest.fixture(scope="module")
def logs(esbc, shared):
    """The first half hour of the ESBC log, combined and not."""
    table = read_observations(next(esbc.glob("*_MO.rnx.gz")))
    antex = (shared / "antex/igs14_sats_only.atx.gz",)
    files = ProductFiles(
        tuple(sorted(esbc.glob("*SP3.gz"))),
        tuple(sorted(esbc.glob("*CLK.gz"))),
        (),
        antex,
        None,
        None,
        "",
        (),
    )
    span = int(table.t_ns[0]), int(table.t_ns[0]) + SPAN_S * 10**9
    return tuple(precise_log(table, files, "GRE", span, combined=c) for c in (True, False))


def split(key: str) -> tuple[str, str]:
    """Return the keys of the parts of a combined row."""
    first, second = key.split("+")
    return first, f"{key[:4]}{second}"


@pytest.mark.parametrize("sensor", ["code", "carrier"])
def test_combined_again_they_are_the_combined_rows(logs, sensor):
    compared = 0
    for whole, parts in zip(*(x.epochs for x in logs), strict=True):
        a, b = whole.sensor(sensor), parts.sensor(sensor)
        if a is None:
            assert b is None
            continue
        at = {key: i for i, key in enumerate(b.keys)}
        assert [k for key in a.keys for k in split(key)] == list(b.keys)
        i, j = np.array([[at[k] for k in split(key)] for key in a.keys]).T
        gamma = b.aux["iono_factor"][j]
        np.testing.assert_array_equal(b.aux["iono_factor"][i], 1.0)
        np.testing.assert_allclose(gamma, (b.aux["freq_hz"][i] / b.aux["freq_hz"][j]) ** 2, rtol=1e-14)
        for one, two, combined in (
            (b.y[i], b.y[j], a.y),
            (b.aux["model_m"][i], b.aux["model_m"][j], a.aux["model_m"]),
        ):
            np.testing.assert_allclose((gamma * one - two) / (gamma - 1.0), combined, atol=1e-6)
        for name in (
            "sv_pos_m",
            "sv_clk_m",
            "clk_node_s",
            *(("arc", "arc_reason") if "arc" in a.aux else ()),
        ):
            np.testing.assert_array_equal(b.aux[name][i], a.aux[name])
            np.testing.assert_array_equal(b.aux[name][j], a.aux[name])
        compared += len(a.keys)
    assert compared > 1000


def test_doppler_is_that_of_the_first_band_and_the_notes_are_the_same(logs):
    combined, apart = logs
    assert combined.notes == apart.notes
    for a, b in zip(combined.epochs, apart.epochs, strict=True):
        one, two = a.sensor("doppler"), b.sensor("doppler")
        assert (one is None) == (two is None)
        if one is not None:
            assert one.keys == two.keys
            np.testing.assert_array_equal(one.y, two.y)


@pytest.mark.parametrize("second", ["2W", "5Q"])
def test_biases_of_the_codes_take_the_satellite_out_of_slant_delays(second):
    """Codes with biases that are known on all signals are all alike after it, whatever is combined."""
    system = "G" if second == "2W" else "E"
    one, two = CLOCK_SIGNALS[system]
    used = ("1C", "2W") if system == "G" else ("1C", "7Q")
    bias = {one: 3e-9, two: -2e-9, used[0]: 4.5e-9, used[1]: 1.25e-9}
    known = CodeBiases({(f"{system}05", k): v for k, v in bias.items()}, {}, 0)
    freq = {k: frequency_hz(system, k, 0) for k in bias}
    gamma = (freq[one] / freq[two]) ** 2
    clocks = (gamma * bias[one] - bias[two]) / (gamma - 1.0)
    table, chosen = _Table(used), _Chosen(system)
    notes: list[str] = []
    apart = _biases(table, known, chosen, np.array([0]), notes, apart=True)
    expected = [299792458.0 * (bias[k] - clocks) for k in used]
    np.testing.assert_allclose(np.concatenate(apart), expected, atol=1e-9)
    combined = _biases(table, known, chosen, np.array([0]), notes)
    ratio = (freq[used[0]] / freq[used[1]]) ** 2
    both = [(ratio * x[0][0] - x[1][0]) / (ratio - 1.0) for x in (apart, combined)]
    assert both[0] == pytest.approx(both[1], abs=1e-9)
    assert notes == []
    assert _against_combination(f"{system}05{one}", None, 0) == 0.0


class _Table:
    """The signals of a table with two rows."""

    def __init__(self, used: tuple[str, str]) -> None:
        self.signal = np.array(used)


class _Chosen:
    """One satellite whose codes are the rows of that table."""

    def __init__(self, system: str) -> None:
        self.sat = np.array([f"{system}05"])
        self.first, self.second = np.array([0]), np.array([1])
