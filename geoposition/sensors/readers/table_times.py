"""The time column of a telemetry table: numbers in some unit, or UTC, to seconds from an epoch."""

from __future__ import annotations

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, ProductError
from geoposition.sensors.readers.attitude_columns import TimeColumn
from geoposition.sensors.readers.table_file import TableFile
from geoposition.timescale import Epoch

_MINUTE = len("2015-10-13T00:00")


def read_times(
    table: TableFile, time: TimeColumn, epoch: Epoch | None = None, strict: bool = True
) -> tuple[FloatArray, Epoch | None]:
    """Seconds (n,), and the epoch from which they count where it is known.

    UTC is counted from the column's own epoch, from `epoch`, or from the first row, in that
    order, as seconds of TAI: leap seconds count. A remark `# epoch: ...Z` in the file is the
    epoch of plain numbers. What is no time is refused, or NaN if not `strict`.
    """
    if not time.utc:
        known = time.epoch
        stated = table.remark("epoch") or table.remark("epoch_utc")
        if known is None and stated is not None:
            try:
                known = Epoch.from_utc(stated)
            except ArgumentError:
                known = None  # a remark in words is no epoch
        read = table.strict if strict else table.numbers
        return read(time.column) * time.unit_s, known
    cells = table.text(time.column)
    start = time.epoch or epoch or _parse(table, time.column, 0, str(cells[0]))
    times = np.empty(len(cells))
    minutes: dict[str, float] = {}
    for k, cell in enumerate(cells.tolist()):
        # The date and minute are parsed once each; the seconds are a plain number.
        text = cell.strip()
        prefix, seconds = text[:_MINUTE], text[_MINUTE + 1 :].removesuffix("Z")
        if prefix in minutes and seconds.replace(".", "", 1).isdecimal() and float(seconds) < 60.0:
            times[k] = minutes[prefix] + float(seconds)
            continue
        try:
            whole = _parse(table, time.column, k, text)
        except ProductError:
            if strict:
                raise
            times[k] = np.nan
            continue
        times[k] = whole - start
        if len(prefix) == _MINUTE and seconds[:2] != "60":
            minutes[prefix] = _parse(table, time.column, k, prefix) - start
    return times, start


def _parse(table: TableFile, column: str, row: int, text: str) -> Epoch:
    try:
        return Epoch.from_utc(text)
    except ArgumentError as error:
        table.refuse(row, column, str(error))
