"""Fixtures for all tests."""

from pathlib import Path

import numpy as np  # noqa: F401
import pytest
import scipy.linalg  # noqa: F401
from threadpoolctl import threadpool_limits

#: Small matrices on a thread each; as in a run. What is loaded by now is what is limited.
LIMIT = threadpool_limits(1, user_api="blas")
SHARED = Path(__file__).resolve().parents[1] / "../shared/data"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real data, beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("shared data not here")
    return SHARED.resolve()
