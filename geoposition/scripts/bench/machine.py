"""The machine a benchmark ran on: processor, versions, memory in use and its bandwidth."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import threading
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Self

import numba
import numpy as np

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_PACKAGES = ("geoposition", "numpy", "numba", "scipy", "rasterio")
_COPY_BYTES = 256 * 1024 * 1024


def cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor() -> str:
    """Name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def environment() -> dict[str, object]:
    """Name what the figures depend on; `load` says how busy the machine was with other things."""
    facts: dict[str, object] = {
        "processor": processor(),
        "cores": cores(),
        "numba_threads": numba.get_num_threads(),
        "python": platform.python_version(),
    }
    for name in _PACKAGES:
        facts[name] = installed(name) or "not installed"
    if hasattr(os, "getloadavg"):
        facts["load"] = round(os.getloadavg()[0], 1)
    return facts


def threading_layer() -> str:
    """How numba's threads work; known only after a parallel kernel ran."""
    try:
        return str(getattr(numba, "threading_layer")())  # noqa: B009 (not exported by its stubs)
    except ValueError:
        return "unknown"


def installed(distribution: str) -> str | None:
    """Version of a distribution, None where there is none."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def copy_gb_s(threads: int, repeats: int = 7, size: int = _COPY_BYTES) -> float:
    """Best rate of plain copies from memory to memory, bytes read and written, GB/s."""
    source = np.ones(size // 8)
    target = np.zeros_like(source)
    parts = np.linspace(0, len(source), threads + 1).astype(np.int64)

    def copy(begin: int, end: int) -> None:
        np.copyto(target[begin:end], source[begin:end])

    best = 0.0
    for _ in range(repeats):
        workers = [
            threading.Thread(target=copy, args=(int(parts[i]), int(parts[i + 1])))
            for i in range(threads)
        ]
        start = time.perf_counter()
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        best = max(best, 2 * size / (time.perf_counter() - start) / 1e9)
    return best


def gflop_s(repeats: int = 7, size: int = 1536) -> float:
    """Best rate of the product of two matrices in 64 bits by BLAS, all cores, 1e9 flop/s.

    Nothing that this machine computes in 64 bits is faster.
    """
    left = np.random.default_rng(0).standard_normal((size, size))
    right, out = left.T.copy(), np.empty_like(left)
    best = 0.0
    for _ in range(repeats):
        start = time.perf_counter()
        np.matmul(left, right, out=out)
        best = max(best, 2e-9 * size**3 / (time.perf_counter() - start))
    return best


class PeakMemory:
    """Context whose `bytes` is how far resident memory rose above where it began.

    None where the system does not tell (other than Linux).
    """

    __slots__ = ("_before", "bytes")

    def __init__(self) -> None:
        self.bytes: float | None = None
        self._before = 0

    def __enter__(self) -> Self:
        _give_back()
        try:
            _CLEAR.write_text("5")
            self._before = _kilobytes("VmRSS")
        except OSError:
            self._before = -1
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._before >= 0:
            self.bytes = 1024.0 * max(_kilobytes("VmHWM") - self._before, 0)


def _give_back() -> None:
    """Return freed memory to the system: else what is taken again would not be seen."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)


def _kilobytes(name: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1])
    raise OSError(f"{name} is not told")
