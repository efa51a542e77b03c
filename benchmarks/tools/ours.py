"""pntegrity itself: snapshot positions, RCTM and the exclusion of the pipeline."""

from __future__ import annotations

from importlib.metadata import version

from benchmarks.tools import Fix
from benchmarks.workload import Workload
from pntegrity.estimators.spp import Spp
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.pipeline import Pipeline
from pntegrity.records import Epoch, State, Update
from pntegrity.run import options_for, pipeline_for


class Ours:
    """The snapshot estimator; its satellite states are made for all epochs of the file together."""

    name = "pntegrity"
    given = "satellite states (made for the whole file at once: the row before)"

    def __init__(self, work: Workload) -> None:
        self.version = version("pntegrity")
        self.work = work
        self._table, self._nav = read_observations(work.obs), read_navigation([work.nav])
        self._estimator = Spp(options_for(work.config(), work.loaded))
        self._config = work.config(estimator="spp", monitors=("rctm",))

    def read_observations(self) -> int:
        """Read the observation file."""
        return len(read_observations(self.work.obs).t_ns)

    def read_navigation(self) -> object:
        """Read the navigation file."""
        return read_navigation([self.work.nav])

    def all_states(self) -> int:
        """Compute the satellite states and the epochs of the whole file; return how many."""
        return len(gnss_epochs(self._table, self._nav).epochs)

    def prepare(self, k: int, faulted: bool) -> Epoch:
        """Return an epoch."""
        return (self.work.faulted if faulted else self.work.loaded).epochs[k]

    def fix(self, prepared: Epoch) -> Fix:
        """Return the least-squares position and velocity."""
        update = self._estimator.correct(self._estimator.predict(State.empty(), prepared), prepared)
        return _fix(update)

    def fix_excluding(self, prepared: Epoch) -> Fix:
        """Return the position that the pipeline commits, the epoch standing alone."""
        pipeline: Pipeline = pipeline_for(self._config, self.work.loaded)
        outcome = pipeline.push(prepared)
        return _fix(outcome.update, outcome.status)


def _fix(update: Update, said: str = "") -> Fix:
    if not update.keys:
        return Fix(None, update.excluded, update.reason)
    return Fix(update.posterior.mean[:3], tuple(sorted(update.excluded)), said)
