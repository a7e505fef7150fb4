"""Kernels over a range of independent items, in the threads of one process.

A kernel takes `low` and `high` first and releases the interpreter's lock. Beside numba's own
parallel loops this compiles in a fifth of the time and leaves a process free to fork.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

_WORTH_A_THREAD = 8


def in_chunks(kernel: Callable[..., None], items: int, *arguments: object) -> None:
    """Call `kernel(low, high, *arguments)` for ranges that together are 0 .. items."""
    threads = min(os.cpu_count() or 1, items // _WORTH_A_THREAD)
    if threads < 2:
        kernel(0, items, *arguments)
        return
    # More ranges than threads: one that the system holds up must not hold up the rest.
    ranges = 4 * threads
    edges = [items * i // ranges for i in range(ranges + 1)]
    with ThreadPoolExecutor(threads) as pool:
        tasks = [
            pool.submit(kernel, low, high, *arguments)
            for low, high in pairwise(edges)
            if high > low
        ]
        for task in tasks:
            task.result()
