from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from pntegrity.config import noise_of, read_noise
from pntegrity.scenarios._real_logs import BRUX, Log, Site
from pntegrity.sensors.noise import NoiseModel


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Keep BLAS to one thread: on small matrices more only get in each other's way."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def site(shared: Path) -> Callable[..., Site]:
    """Return what reads a log, or skips the test where it is not here."""

    def read(log: Log, noise: NoiseModel | None = None) -> Site:
        missing = log.missing(shared)
        if missing:
            pytest.skip(missing)
        return Site(log, shared, noise)

    return read


@pytest.fixture(scope="session")
def fitted() -> NoiseModel:
    """What `pntegrity calibrate` made of the first half of the BRUX log."""
    return noise_of(read_noise(Path(__file__).with_name("brux_noise.toml")))


@pytest.fixture(scope="session")
def brux(site: Callable[..., Site], fitted: NoiseModel) -> Site:
    return site(BRUX, fitted)
