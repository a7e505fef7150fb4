"""Processes for independent parts of a work, and how many threads each of them gets."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Final

_THREADS: Final = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "GDAL_NUM_THREADS",
)


def cores() -> int:
    """Return the number of processors."""
    return os.cpu_count() or 1


@contextmanager
def threads_each(count: int) -> Iterator[None]:
    """Give processes that are started within `count` threads each."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, str(count)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def process_pool(processes: int, threads: int = 1) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of `processes` with `threads` each; spawned, for compiled loops bear no fork."""
    with (
        threads_each(threads),
        ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool,
    ):
        yield pool
