"""``pntegrity run`` with protection levels: messages that cannot be, budgets that cannot be met, what is
told.
"""

from __future__ import annotations

import numpy as np
import pytest

SEPARATION = ("--monitors", "separation")
WRONG = {
    "p_sat = 1.5": ("`p_sat` must be", "at most 1", "not 1.5"),
    "p_constellation = -1e-4": ("`p_constellation` must be", "at least 0"),
    "p_trop = nan": ("`p_trop` must be", "not nan"),
    "p_sat = 0.75\np_user = 0.5": ("`p_sat + p_dcb + p_iono_sat + p_user` must be", "1.25"),
    "p_satt = 1e-5": ("no field `p_satt`",),
    "p_hmi = 0.0": ("`p_hmi` must be", "above 0"),
    "split = [0.5, 0.5, 0.5]": ("`split` must be", "add up to 1"),
    "[satellites]\nG7 = 1e-5": ("`satellites` must name", "'G7'"),
    "[satellites]\nG07 = 2": ("`satellites.G07` must be",),
    "[constellations.G]\np_sat = 1e-5": ("`constellations.G` must hold",),
    "p_sat = ": ("not TOML", "line 1"),
}


@pytest.fixture
def message(tmp_path):
    """Write an integrity support message."""

    def write(text):
        path = tmp_path / "ism.toml"
        path.write_text(text + "\n")
        return path

    return write


@pytest.mark.parametrize("text", WRONG)
def test_a_message_that_cannot_be_is_refused_by_file_and_field(run, message, text):
    done = run(*SEPARATION, "--ism", message(text), "--end", "5")
    assert done.called.refused("ism.toml", *WRONG[text])
    assert not done.folder.exists() or not list(done.folder.iterdir())


def test_a_message_that_is_not_there(run, tmp_path):
    assert run(*SEPARATION, "--ism", tmp_path / "none.toml").called.refused("none.toml", "No such file")


def test_a_budget_that_cannot_be_met_is_no_level_with_the_reason_and_no_crash(run, message):
    done = run(*SEPARATION, "--ism", message("p_sat = 0.4\nmax_modes = 4"))
    assert done.called.code == 0
    assert np.isinf(done.verdicts["hpl_m"].to_numpy()).all()
    assert np.isinf(done.verdicts["vpl_m"].to_numpy()).all()
    assert done.verdicts["pl_reason"].str.contains("no less than the integrity risk").all()
    assert "no finite protection level" in done.called.out
    assert done.summary["protection"]["unbounded"]["epochs"] == 60
    assert done.summary["protection"]["hpl_m"]["median"] is None


def test_probabilities_that_are_all_nothing_make_the_run_unavailable_and_never_ok(run, message):
    nothing = "p_sat = 0.0\np_trop = 0.0\np_iono = 0.0\np_other = 0.0"
    done = run(*SEPARATION, "--ism", message(nothing), "--end", "10")
    assert set(done.verdicts["status"]) == {"unavailable"}
    assert set(done.solution["status"]) == {"unavailable"}
    assert done.verdicts["reason"].str.contains("no fault mode").all()
    assert np.isfinite(done.verdicts["hpl_m"].to_numpy()).all()  # of the noise alone


@pytest.mark.parametrize("option", ["--atmosphere", "--clas"])
@pytest.mark.parametrize("estimator", ["spp", "spp_kf", "ppp"])
def test_products_of_the_atmosphere_go_with_ppp_rtk_alone(run, tmp_path, option, estimator):
    path = tmp_path / "p.csv"
    path.write_text("x\n")
    done = run("--estimator", estimator, option, path)
    assert done.called.refused(option.strip("-"), "ppp_rtk", estimator)


@pytest.mark.parametrize("estimator", ["spp", "spp_kf"])
def test_every_epoch_has_a_level_or_a_reason(run, estimator):
    done = run("--estimator", estimator, *SEPARATION)
    assert done.called.code == 0
    for name in ("hpl_m", "vpl_m", "pl_east_m", "pl_north_m", "pl_up_m"):
        values = done.verdicts[name].to_numpy()
        assert not np.isnan(values).any()
        assert (values > 0.0).all()
    unbounded = done.verdicts.filter(done.verdicts["hpl_m"].is_infinite())
    assert (unbounded["pl_reason"].str.len_chars() > 0).all()
    assert done.excluded == ["G07"]
    assert set(done.verdicts.filter("final")["status"]) == {"ok"}


def test_a_single_constellation_that_may_fail_is_named_where_nothing_checks_it(run, message):
    ism = message("p_constellation = 1e-4")
    done = run("--estimator", "spp", *SEPARATION, "--systems", "G", "--ism", ism, "--end", "15")
    assert done.called.code == 0
    assert np.isinf(done.verdicts["hpl_m"].to_numpy()).all()
    assert set(done.verdicts["pl_reason"]) == {"nothing is left to check against without G"}


def test_a_constellation_that_vanishes_in_mid_run_costs_levels_and_is_told(run, files, message):
    # GIVEN Galileo gone after half a minute, and constellations that may fail
    cut = [without(e, "E") if k >= 30 else e for k, e in enumerate(files.epochs)]
    done = run("--estimator", "spp", *SEPARATION, "--ism", message("p_constellation = 1e-6"), epochs=cut)
    assert done.called.code == 0
    final = done.verdicts.filter("final")
    hpl = final["hpl_m"].to_numpy()
    # THEN there are levels before, and none after, with the reason
    assert np.isfinite(hpl[:30]).all()
    assert np.isinf(hpl[31:]).all()
    assert set(final["pl_reason"][31:]) == {"nothing is left to check against without G"}
    assert not np.isnan(hpl).any()


def without(epoch: str, letter: str) -> str:
    """Return an epoch of RINEX 3 without a constellation."""
    first, *lines = epoch.split("\n")
    kept = [line for line in lines if not line.startswith(letter)]
    count = sum(len(line) > 3 for line in kept)
    return "\n".join([f"{first[:32]}{count:3d}{first[35:]}", *kept])


def test_fewer_satellites_than_states_is_unavailable_with_levels_that_are_none(run, files):
    few = [three(e) if k >= 20 else e for k, e in enumerate(files.epochs[:40])]
    done = run("--estimator", "spp", *SEPARATION, epochs=few)
    assert done.called.code == 0
    final = done.verdicts.filter("final")
    assert set(final["status"][20:]) == {"unavailable"}
    assert all(final["reason"][20:])
    levels = final["hpl_m"][20:].drop_nulls().to_numpy()
    assert not np.isnan(levels).any()
    assert np.isinf(levels).all()


def three(epoch: str) -> str:
    first, *lines = epoch.split("\n")
    kept = [line for line in lines if len(line) > 3][:3]
    return "\n".join([f"{first[:32]}{3:3d}{first[35:]}", *kept, ""])


def test_a_false_alert_probability_given_to_the_run_is_that_of_the_message(run, message):
    one = run(*SEPARATION, "--p-fa", "1e-4", "--end", "5").verdicts
    two = run(*SEPARATION, "--p-fa", "1e-4", "--ism", message("p_fa = 1e-5"), "--end", "5").verdicts
    assert set(one["p_fa"]) == {1e-4}
    assert set(two["p_fa"]) == {1e-5}
    assert (two["hpl_m"] > one["hpl_m"]).all()
