"""A disk that takes nothing more, for this process."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

SIZE = 100  # [bytes] that each file still takes


@pytest.fixture
def full_disk() -> Iterator[None]:
    """Files of this process get no longer than SIZE; writing more is an ordinary error."""
    resource = pytest.importorskip("resource", reason="no file size limit")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (SIZE, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)
