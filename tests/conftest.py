"""What several test modules share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A running cluster with two workers, as a lab would have one."""
    from machopt.batch.engine import ANY_PORT

    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, scheduler_kwargs=ANY_PORT, memory_limit=0, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address
