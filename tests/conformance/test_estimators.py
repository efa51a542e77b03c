"""What every estimator must be: pure, blind to the order of rows, and exclusion is absence."""

from __future__ import annotations

import pickle
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from everyone import SOURCES, every_source, source

from gnss_logs import fingerprint, shuffled, without
from pntegrity import estimators
from pntegrity.protocols import Estimator
from pntegrity.records import State, Update, group_of


@lru_cache(maxsize=8)
def chain(where: str) -> tuple[tuple[State, Update], ...]:
    """Return the state before each epoch and the update, nothing excluded."""
    s, state, out = source(where), State.empty(), []
    for epoch in s.epochs:
        update = s.estimator.correct(s.estimator.predict(state, epoch), epoch)
        out.append((state, update))
        state = update.posterior
    return tuple(out)


@every_source
def test_it_is_an_estimator_and_a_value(where):
    estimator = source(where).estimator
    assert isinstance(estimator, Estimator)
    assert fingerprint(pickle.loads(pickle.dumps(estimator))) == fingerprint(estimator)


@every_source
def test_all_steps_are_pure(where):
    s = source(where)
    for (state, update), epoch in zip(chain(where)[::4], s.epochs[::4], strict=True):
        before = fingerprint(state), fingerprint(epoch)
        prior = s.estimator.predict(state, epoch)
        kept = fingerprint(prior)
        some = frozenset(list(update.groups())[:2])
        excluded = s.estimator.correct(prior, epoch, some)
        relaxed = fingerprint(s.estimator.relax(prior))
        assert fingerprint(s.estimator.relax(prior)) == relaxed
        assert fingerprint(s.estimator.correct(prior, epoch)) == fingerprint(update)
        assert fingerprint(s.estimator.correct(prior, epoch, some)) == fingerprint(excluded)
        assert fingerprint(s.estimator.predict(state, epoch)) == kept == fingerprint(prior)
        assert (fingerprint(state), fingerprint(epoch)) == before


@every_source
def test_an_update_is_whole(where):
    for state, u in chain(where):
        m, n = len(u.keys), len(u.prior)
        assert (u.nu.shape, u.H.shape, u.R.shape, u.F.shape, u.Q.shape) == (
            (m,),
            (m, n),
            (m, m),
            (n, len(state)),
            (n, n),
        )
        assert all(
            np.isfinite(a).all()
            for a in (u.nu, u.H, u.R, u.F, u.Q, u.prior.P, u.posterior.P, u.posterior.mean)
        )
        assert u.posterior.layout == u.prior.layout
        assert len(set(u.keys)) == m
        assert bool(u.keys) != bool(u.reason)
        assert all(len(values) == m for values in u.aux.values())
        for P in (u.prior.P, u.posterior.P):
            assert np.array_equal(P, P.T)
            assert n == 0 or np.linalg.eigvalsh(_correlation(P)).min() > -1e-12
        assert np.all(np.diagonal(u.posterior.P) <= np.diagonal(u.prior.P) * (1.0 + 1e-9))
        assert not any(
            a.flags.writeable for a in (u.nu, u.H, u.R, u.F, u.Q, u.prior.P, u.posterior.mean, u.posterior.P)
        )


def _correlation(P: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.diagonal(P))
    return P / np.outer(scale, scale)


@every_source
def test_the_prior_is_the_linear_step_of_the_last_posterior(where):
    for state, u in chain(where):
        if u.F.any():
            P = u.F @ state.P @ u.F.T + u.Q
            np.testing.assert_allclose(_scaled(u.prior.P, P), _scaled(P, P), atol=1e-9)


def _scaled(P: np.ndarray, by: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.diagonal(by))
    return P / np.outer(scale, scale)


@every_source
def test_a_relaxed_prior_knows_less_and_is_still_a_linear_step(where):
    s = source(where)
    for (state, _), epoch in list(zip(chain(where), s.epochs, strict=True))[::5]:
        prior = s.estimator.predict(state, epoch)
        relaxed = s.estimator.relax(prior)
        assert relaxed.state.layout == prior.state.layout
        assert np.array_equal(relaxed.state.mean, prior.state.mean)
        assert relaxed.consumed >= prior.consumed
        if len(prior.state) and relaxed is not prior:
            P = relaxed.F @ state.P @ relaxed.F.T + relaxed.Q
            np.testing.assert_allclose(_scaled(relaxed.state.P, P), _scaled(P, P), atol=1e-9)
            assert np.all(np.diagonal(relaxed.state.P) >= np.diagonal(prior.state.P) * (1.0 - 1e-12))
            assert relaxed.events != prior.events


@every_source
def test_an_excluded_group_is_an_absent_one(where):
    # GIVEN a running filter and a satellite of an epoch, healthy or not
    s = source(where)
    for k in range(15, len(s.epochs), 7):
        (state, update), epoch = chain(where)[k], s.epochs[k]
        for group in list(update.groups())[:6]:
            # WHEN it is excluded, and when it was never there
            excluded = s.estimator.correct(s.estimator.predict(state, epoch), epoch, frozenset([group]))
            gone = without(epoch, [group])
            absent = s.estimator.correct(s.estimator.predict(state, gone), gone)
            # THEN all that both know is the same, and its rows are kept aside for its proof
            assert set(excluded.keys) == set(absent.keys)
            same_belief(excluded.posterior, absent.posterior, 1e-5)
            assert excluded.excluded == (group,)
            assert {group_of(key) for key in excluded.spare_keys} == {group}
            assert np.isfinite(excluded.spare_nu).all()
            assert (excluded.spare_var > 0.0).all()


def same_belief(a: State, b: State, atol: float) -> None:
    names = [n for n in a.layout.names if n in b.layout.index]
    i, j = ([s.layout.index[n] for n in names] for s in (a, b))
    sigma = np.sqrt(np.diagonal(a.P)[i])
    np.testing.assert_allclose((a.mean[i] - b.mean[j]) / sigma, 0.0, atol=atol)
    np.testing.assert_allclose(
        (a.P[np.ix_(i, i)] - b.P[np.ix_(j, j)]) / np.outer(sigma, sigma), 0.0, atol=atol
    )


@every_source
def test_no_order_of_rows_or_sensors_matters(where):
    s, rng = source(where), np.random.default_rng(9)
    state = State.empty()
    for k, epoch in enumerate(s.epochs):
        mixed = shuffled(epoch, rng)
        update = s.estimator.correct(s.estimator.predict(state, mixed), mixed)
        state = update.posterior
        plain = chain(where)[k][1]
        assert set(update.keys) == set(plain.keys)
        assert set(state.layout.names) == set(plain.posterior.layout.names)
        if len(state):
            same_belief(plain.posterior, state, 1e-5)


def test_every_estimator_is_found_by_existing():
    folder = Path(estimators.__file__).parent
    assert set(estimators.discover()) == {p.stem for p in folder.glob("[!_]*.py")}
    assert set(SOURCES) > set(estimators.discover())


@pytest.mark.parametrize("name", sorted(estimators.discover()))
def test_its_docstring_says_what_it_is(name):
    text = estimators.discover()[name].__doc__
    assert "Parameters" in text
    assert len(text.splitlines()) > 5
