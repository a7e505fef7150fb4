"""How many threads compiled loops get: starting them costs more than a short loop takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numba

WORTH_THREADS: Final = 16_384
"""Items of some hundred operations; below, a second thread gains less than waking it costs."""


@contextmanager
def threads_for(items: int) -> Iterator[None]:
    """Run the parallel loops inside on one thread if they have few `items`.

    On a machine with other work the threads of a short loop wait for each other longer than
    they compute, by a factor of ten and more.
    """
    before = numba.get_num_threads()
    if items >= WORTH_THREADS or before == 1:
        yield
        return
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
