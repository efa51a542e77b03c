"""The embedded demo: its files are what its description makes, small, and as bad as they should be."""

import gzip

import numpy as np
import pytest

from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.truth import read_truth
from pntegrity.physics.gnss_epochs import gnss_epochs
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
