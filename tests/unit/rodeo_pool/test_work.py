"""A worker's helper that does not do what it should costs its job, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.jobs.job import WorkerLost


def test_a_helper_that_reads_nothing_is_lost_in_time(tmp_path: Path) -> None:
    from rodeo_pool.work import Helper  # dask takes its time

    helper = Helper(["sleep", "1000"], tmp_path / "log")
    with pytest.raises(WorkerLost, match="hung"):
        helper.ask(bytes(1 << 20), 0.0, lambda: True)
    assert not helper.is_running
