"""The embedded demo: its files are what its description makes, small, and as bad as they should be."""

import gzip

import numpy as np
import pytest

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.alarms import evaluate
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.truth import read_truth
from pntegrity.monitors import discover
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.pipeline import Pipeline
from pntegrity.scenarios.demo import build_demo, demo_facts, demo_paths


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return build_demo(tmp_path_factory.mktemp("demo"))


def test_the_same_seed_gives_the_same_bytes(built, tmp_path):
    for a, b in zip(built, build_demo(tmp_path), strict=True):
        assert a.read_bytes() == b.read_bytes()


def test_the_shipped_files_are_what_the_description_makes(built):
    with demo_paths() as demo:
        for shipped, made in zip((demo.obs, demo.nav, demo.truth), built, strict=True):
            assert gzip.decompress(shipped.read_bytes()) == gzip.decompress(made.read_bytes())
        assert sum(p.stat().st_size for p in (demo.obs, demo.nav, demo.truth)) < 400_000


def test_the_log_reads_without_a_complaint_and_has_what_it_says():
    with demo_paths() as demo:
        table, nav, truth = read_observations(demo.obs), read_navigation(demo.nav), read_truth(demo.truth)
        faults = demo.faults
    assert (table.notes, nav.notes, truth.notes) == ((), (), ())
    epochs = gnss_epochs(table, nav).epochs
    facts = demo_facts()
    assert len(epochs) == len(truth.t_ns) == facts["epochs"]
    seen = [{k[:3] for k in e.sensor("code").keys} for e in epochs]
    assert all(s == set(facts["outage"]["satellites"]) for s in seen[250:260])
    assert min(len(s) for s in seen[:250] + seen[260:]) >= 14
    for fault in faults:
        onset = fault.onset_ns(0) // 10**9
        assert fault.hits(seen[onset])


def test_another_generator_makes_another_log(built, tmp_path):
    obs, nav, _ = build_demo(tmp_path, np.random.default_rng(1))
    assert obs.read_bytes() != built[0].read_bytes()
    assert nav.read_bytes() == built[1].read_bytes()


def test_the_default_run_finds_every_fault_and_blames_nobody_else():
    """GIVEN the demo, WHEN all monitors run with exclusion, THEN the faults are found, the position kept."""
    with demo_paths() as demo:
        loaded = gnss_epochs(read_observations(demo.obs), read_navigation(demo.nav))
        truth, faults = read_truth(demo.truth), demo.faults
    monitors = [monitor() for monitor in discover().values()]
    pipeline = Pipeline(SppKf(GnssOptions(klobuchar=loaded.klobuchar)), monitors)
    outcomes = [pipeline.push(epoch) for epoch in loaded.epochs]
    alarms = [any(v.status == "alert" for v in o.first) for o in outcomes]
    excluded = [o.update.excluded for o in outcomes]
    score = evaluate(truth.t_ns, alarms, faults, excluded=excluded, recovery_s=60.0)
    assert score.right_satellite == (True, True, True, True)
    assert score.wrong_exclusions == ()
    assert score.delays_s[0] == score.delays_s[2] == score.delays_s[3] == 0.0
    assert score.delays_s[1] <= 20.0
    places = np.array([o.update.posterior.mean[:3] for o in outcomes])
    assert np.linalg.norm(places - truth.position_m, axis=1).max() < 5.0
