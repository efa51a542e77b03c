"""The front door: light to import, and ten lines that watch somebody else's filter."""

from __future__ import annotations

import doctest
import importlib.util
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import pntegrity
from pntegrity import Aime, Glr, Rctm, Update, Watch, monitors
from pntegrity.simulate.linear import Disturbance, linear_updates, spp_model

ROOT = Path(__file__).parents[1]


def test_importing_the_package_costs_nothing():
    code = "import sys, pntegrity; pntegrity.__version__; dir(pntegrity); print('numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "False"


def test_every_name_of_the_front_door_is_there():
    for name in pntegrity.__all__:
        assert getattr(pntegrity, name) is not None
        assert name in dir(pntegrity)
    assert {cls.__name__ for cls in monitors.discover().values()} <= set(pntegrity.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Nonsense'"):
        pntegrity.Nonsense  # noqa: B018


def test_a_watch_says_what_the_monitors_say():
    rows = np.zeros((40, 16))
    rows[25:, 3] = 20.0
    updates = linear_updates(spp_model(8), 40, np.random.default_rng(1), Disturbance(rows=rows))
    watch, every = Watch([Rctm(), Aime(), Glr()]), (Rctm(), Aime(), Glr())
    memories = [m.start() for m in every]
    for k, update in enumerate(updates):
        steps = [m.step(memory, update) for m, memory in zip(every, memories, strict=True)]
        memories = [memory for _, memory in steps]
        found = watch.push(update)
        assert found == [v for v, _ in steps]
        assert all((v.status == "alert") >= (k == 25) for v in found)


def test_a_watch_goes_on_from_its_memories():
    updates = linear_updates(spp_model(8), 30, np.random.default_rng(2))
    whole, first = Watch([Aime(), Glr()]), Watch([Aime(), Glr()])
    verdicts = [whole.push(u) for u in updates]
    for u in updates[:17]:
        first.push(u)
    second = Watch([Aime(), Glr()], pickle.loads(pickle.dumps(first.memories)))
    assert [second.push(u) for u in updates[17:]] == verdicts[17:]
    with pytest.raises(ValueError, match="`memories`"):
        Watch([Aime()], first.memories)


@pytest.fixture(scope="module")
def own_filter():
    path = ROOT / "docs" / "examples" / "own_filter.py"
    spec = importlib.util.spec_from_file_location("own_filter", path)
    module = importlib.util.module_from_spec(spec)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # filterpy's docstrings have escapes that new Pythons warn of
        pytest.importorskip("filterpy.kalman")
        spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_example_with_a_filter_of_ones_own(own_filter, seed):
    # GIVEN a filterpy filter whose first sensor drifts by 0.1 m/s from 100 s on
    verdicts = list(own_filter.watched(np.random.default_rng(seed)))
    glr = [v for _, v in verdicts]
    # THEN nothing is said before, and GLR names the sensor, the rate and the onset some seconds later
    assert not [v for epoch in verdicts[:101] for v in epoch if v.status == "alert"]
    at = next(k for k, v in enumerate(glr) if v.status == "alert")
    assert 105 < at < 140
    late = next(v for v in glr[at + 5 :] if v.status == "alert")
    suspect = late.suspects[0]
    assert suspect.groups == ("gnss",)
    assert suspect.kind == "ramp"
    assert suspect.size == pytest.approx(0.1, abs=0.04)
    assert suspect.onset_ns * 1e-9 == pytest.approx(100.0, abs=8.0)


def test_the_example_hands_over_what_the_filter_did(own_filter):
    kf = own_filter.constant_velocity()
    kf.predict()
    P_prior = kf.P.copy()
    kf.update(np.array([1.0, 2.0, 3.0]))
    update = Update.from_filter(0, F=kf.F, Q=kf.Q, H=kf.H, R=kf.R, P_prior=P_prior, nu=kf.y)
    np.testing.assert_allclose(update.S, kf.S)
    np.testing.assert_allclose(update.K, kf.K)
    np.testing.assert_allclose(update.posterior.P, kf.P)
    assert update.keys == ("z0:L", "z1:L", "z2:L")


WRONG = [
    {"H": np.eye(3)}, {"R": np.eye(2)}, {"nu": np.zeros(2)}, {"P_prior": np.eye(3)}, {"F": np.eye(3)},
    {"Q": np.eye(3)},
    {"F": 1.0}, {"keys": ("a:L", "b:L")}, {"keys": ("a:L", "a:L", "b:L")}, {"states": ("pos:x",)},
]  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG, ids=lambda w: next(iter(w)))
def test_matrices_that_do_not_fit_are_refused_with_their_shapes(wrong):
    good = {
        "F": np.eye(2),
        "Q": np.eye(2),
        "H": np.ones((3, 2)),
        "R": np.eye(3),
        "P_prior": np.eye(2),
        "nu": np.zeros(3),
    }
    assert Update.from_filter(0, **good).keys == ("z0:L", "z1:L", "z2:L")
    with pytest.raises(ValueError, match=r"do not fit|`keys` must be 3 different names"):
        Update.from_filter(0, **(good | wrong))


MODULES = [
    "pntegrity.watch", "pntegrity.simulate.faults", "pntegrity.simulate._fault_text",
    *(f"pntegrity.monitors.{name}" for name in sorted(monitors.discover())),
]  # fmt: skip


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_in_the_docstrings_are_true(name):
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
