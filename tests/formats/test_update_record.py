import importlib.util
import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.atomic import atomically
from pntegrity.formats.update_record import read_record, write_record
from pntegrity.kernels.linear import predict_covariance
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.records import State, Update

spec = importlib.util.spec_from_file_location(
    "simulated", Path(__file__).parents[1] / "report" / "simulated.py"
)
simulated = importlib.util.module_from_spec(spec)
spec.loader.exec_module(simulated)


def entries(outcomes):
    return [(u, 0 if i else o.rewound) for o in outcomes for i, u in enumerate(o.updates)]


@pytest.fixture(scope="module")
def run():
    return simulated.run(simulated.epochs(fault=simulated.faults))


def assert_same(a: Update, b: Update) -> None:
    for name in ("t_ns", "keys", "excluded", "consumed", "events", "reason", "spare_keys"):
        assert getattr(a, name) == getattr(b, name)
    for name in ("nu", "H", "R", "F", "Q", "spare_nu", "spare_var", "S", "L", "K", "white", "absorbed"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for x, y in ((a.prior, b.prior), (a.posterior, b.posterior)):
        assert x.layout == y.layout
        assert np.array_equal(x.mean, y.mean)
        assert np.array_equal(x.P, y.P)
    assert a.aux.keys() == b.aux.keys()
    assert all(np.array_equal(a.aux[k], b.aux[k], equal_nan=True) for k in a.aux)


def round_trip(path, given):
    write_record(path, given, {"p_fa": 1e-6})
    record = read_record(path)
    back = list(record)
    assert len(record) == len(given) == len(back)
    for (a, i), (b, j) in zip(given, back, strict=True):
        assert i == j
        assert_same(a, b)
    return record


def test_a_run_with_births_deaths_a_gap_and_a_repair_comes_back_bit_for_bit(run, tmp_path):
    assert any(o.rewound for o in run)
    assert len({o.update.prior.layout for o in run}) > 2
    record = round_trip(tmp_path / "updates.npz", entries(run))
    assert len(record.arrays["prior_P_at"]) == len(record.arrays["posterior_P_at"]) == 0
    assert record.about == {"p_fa": 1e-6}
    assert record.t_ns[0] == run[0].t_ns


def test_monitors_give_the_same_verdicts_from_the_record(run, tmp_path):
    write_record(tmp_path / "updates.npz", entries(run))
    monitors = simulated.monitors()
    memories = [m.start() for m in monitors]
    said = {}
    for update, rewound in read_record(tmp_path / "updates.npz"):
        if rewound:
            memories = [m.start() for m in monitors]
        pairs = [m.step(memory, update) for m, memory in zip(monitors, memories, strict=True)]
        memories = [memory for _, memory in pairs]
        said.setdefault(update.t_ns, tuple(v for v, _ in pairs))  # epochs of a repair come twice
    assert [said[o.t_ns] for o in run] == [o.verdicts for o in run]


def foreign(n: int = 12, seed: int = 2) -> list[tuple[Update, int]]:
    """Updates of a filter whose prediction uses other arithmetic (and another process noise than it says)."""
    rng = np.random.default_rng(seed)
    F, Q, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag([0.1, 0.01]), rng.standard_normal((3, 2))
    R = 0.3 * np.eye(3) + 0.1
    P, out = 10.0 * np.eye(2), []
    for k in range(n):
        P = predict_covariance(F, P, Q) * (1.0 + 1e-3 * k)
        u = Update.from_filter(k * 10**9, F=F, Q=Q, H=H, R=R, P_prior=P, nu=rng.standard_normal(3))
        out.append((u, 0))
        P = np.array(u.posterior.P)
    return out


def test_another_filters_covariances_come_back_too(tmp_path):
    record = round_trip(tmp_path / "a.npz", foreign())
    assert len(record.arrays["prior_P_at"]) > 0


def test_posteriors_that_are_not_the_optimal_ones_are_kept(tmp_path):
    odd = []
    for u, _ in foreign():
        worse = State(u.t_ns, u.posterior.mean + 1.0, 1.5 * u.posterior.P, u.posterior.layout)
        odd.append((replace(u, posterior=worse), 0))
    record = round_trip(tmp_path / "a.npz", odd)
    assert len(record.arrays["posterior_P_at"]) == len(odd)


def test_a_run_without_epochs(tmp_path):
    round_trip(tmp_path / "a.npz", [])


def test_updates_without_rows_or_states(tmp_path):
    none = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    state = State.empty(5)
    empty = Update(
        5, (), *none, np.zeros((0, 0)), np.zeros((0, 0)), state, state, reason="too few; naïve \x00 end "
    )
    round_trip(tmp_path / "a.npz", [(empty, 0), *foreign(3), (empty, 0)])


def test_reading_twice_gives_the_same(run, tmp_path):
    write_record(tmp_path / "a.npz", entries(run[:5]))
    record = read_record(tmp_path / "a.npz")
    assert [u.t_ns for u, _ in record] == [u.t_ns for u, _ in record]


def test_real_data_come_back_bit_for_bit(shared, tmp_path):
    from pntegrity.estimators._gnss import GnssOptions
    from pntegrity.estimators.spp_kf import SppKf
    from pntegrity.formats.rinex_nav import read_navigation
    from pntegrity.formats.rinex_obs import read_observations
    from pntegrity.physics.gnss_epochs import gnss_epochs
    from pntegrity.pipeline import Pipeline

    folder = shared / "brux-static-2019014"
    table = read_observations(next(folder.glob("BRUX*")))
    first = int(table.t_ns[0])
    loaded = gnss_epochs(table, read_navigation([next(folder.glob("BRDC*"))]), end_ns=first + 90 * 10**9)
    pipeline = Pipeline(SppKf(GnssOptions(klobuchar=loaded.klobuchar)), [Rctm(), Aime(), Glr(longest=16)])
    round_trip(tmp_path / "a.npz", entries([pipeline.push(e) for e in loaded.epochs]))
    assert (tmp_path / "a.npz").stat().st_size < 15e6 * len(loaded.epochs) / 900 + 3e5


# --- what is not a record


@pytest.mark.parametrize("part", [0.0, 0.01, 0.5, 0.99, 0.9999])
def test_a_truncated_file_is_refused(run, tmp_path, part):
    write_record(tmp_path / "a.npz", entries(run[:10]))
    raw = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(raw[: int(part * len(raw))])
    with pytest.raises(InputError, match=r"b\.npz"):
        read_record(tmp_path / "b.npz")


def test_foreign_files_are_refused(tmp_path):
    (tmp_path / "text").write_text("not a record")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "pickle.npz", format=np.array([{"a": 1}], dtype=object))
    for name in ("text", "other.npz", "array.npy", "pickle.npz", "missing", "."):
        with pytest.raises(InputError):
            read_record(tmp_path / name)


def test_a_newer_version_is_refused(run, tmp_path):
    write_record(tmp_path / "a.npz", entries(run[:2]))
    arrays = dict(read_record(tmp_path / "a.npz").arrays)
    np.savez(tmp_path / "b.npz", **(arrays | {"version": np.array(99)}))
    with pytest.raises(InputError, match="newer"):
        read_record(tmp_path / "b.npz")


def test_arrays_that_do_not_fit_are_refused_and_nothing_else_happens(run, tmp_path):
    write_record(tmp_path / "a.npz", entries(run[:6]))
    arrays = dict(read_record(tmp_path / "a.npz").arrays)
    for name, values in arrays.items():
        for wrong in (
            values[:-1] if values.ndim else values,
            np.zeros_like(values),
            np.full(values.shape, 10**6, dtype=np.int64),
        ):
            np.savez(tmp_path / "b.npz", **(arrays | {name: wrong}))
            with suppress(InputError):
                list(read_record(tmp_path / "b.npz"))


def test_flipped_bytes_are_refused_or_harmless(run, tmp_path):
    write_record(tmp_path / "a.npz", entries(run[:4]))
    raw = bytearray((tmp_path / "a.npz").read_bytes())
    rng = np.random.default_rng(5)
    for at in rng.integers(0, len(raw), 60).tolist():
        changed = raw.copy()
        changed[at] ^= 0xFF
        (tmp_path / "b.npz").write_bytes(changed)
        with suppress(InputError):
            list(read_record(tmp_path / "b.npz"))


def test_a_failure_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail():
        with atomically(path) as temporary:
            temporary.write_text("half")
            raise OSError(28, "disk full")

    with pytest.raises(InputError, match="disk full"):
        fail()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_folder_that_is_not_there_is_said(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_record(tmp_path / "no" / "a.npz", [])
