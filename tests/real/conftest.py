from pathlib import Path

import pytest

from pntegrity.config import noise_of, read_noise
from pntegrity.scenarios._real_logs import BRUX, Log, Site
from pntegrity.sensors.noise import NoiseModel


def site(shared: Path, log: Log, noise: NoiseModel | None = None) -> Site:
    missing = log.missing(shared)
    if missing:
        pytest.skip(missing)
    return Site(log, shared, noise)


@pytest.fixture(scope="session")
def fitted() -> NoiseModel:
    """What `pntegrity calibrate` made of the first half of the BRUX log."""
    return noise_of(read_noise(Path(__file__).with_name("brux_noise.toml")))


@pytest.fixture(scope="session")
def brux(shared: Path, fitted: NoiseModel) -> Site:
    return site(shared, BRUX, fitted)
