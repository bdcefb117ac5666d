"""Converts events from the forms that other libraries use to structured arrays."""

from collections import abc

import numpy as np

from ._evcal import _columns, _polarities

OWN = np.dtype(
    {"names": ["t", "x", "y", "p"], "formats": ["<i8", "<u2", "<u2", "u1"], "offsets": [0, 8, 10, 12], "itemsize": 16}
)
MICROSECONDS = {"s": 1_000_000, "ms": 1000, "us": 1}


def structured(events, columns=None, time_unit=None):
    """Returns events as a structured array. One of whole numbers, with times in microseconds, is returned without a copy."""
    if not isinstance(events, np.ndarray) and not _is_table(events):
        events = _array(events)
    if _is_table(events):
        names = [str(name) for name in (events if isinstance(events, abc.Mapping) else events.columns)]
        values = [_array(events[name]) for name in names]
    elif events.dtype.names is not None:
        if columns is None and time_unit in (None, "us") and _is_plain(events.dtype):
            return events
        names = list(events.dtype.names)
        values = [events[name] for name in names]
    else:
        names, values = None, _split(events)
    if columns is not None and names is not None:
        raise ValueError("the columns of the events have names: leave out columns")
    order, unit = _columns(names, _sample(values) if names is None else None, columns)
    if len(order.split(",")) != len(values):
        raise ValueError(f"columns={columns!r} does not name all {len(values)} columns of the events")
    named = dict(zip(order.split(","), values, strict=True))
    return _joined(named, time_unit or unit)


def _is_table(events):
    return isinstance(events, abc.Mapping) or (hasattr(events, "columns") and hasattr(events, "__getitem__"))


def _array(values):
    if not hasattr(values, "__array__"):
        # Event stores of dv-processing and tensors have a method numpy.
        if hasattr(values, "numpy"):
            return np.asarray(values.numpy())
        if hasattr(values, "__dlpack__"):
            return np.from_dlpack(values)
    return np.asarray(values)


def _is_plain(dtype):
    return all(dtype[index].kind in "iub" and dtype[index].isnative for index in range(len(dtype.names)))


def _split(array):
    if array.ndim == 2 and array.shape[1] == 4:
        return list(array.T)
    if array.ndim == 2 and array.shape[0] == 4:
        return list(array)
    raise TypeError(
        "events are a structured array with the fields t, x, y and p, an array of N x 4 numbers, or a dict or data frame "
        f"with these columns; this is {type(array).__name__} of shape {array.shape} and type {array.dtype}"
    )


def _sample(values):
    return np.column_stack([column[:2000] for column in values]).astype(np.float64)


def _joined(named, time_unit):
    lengths = {len(named[name]) for name in "txyp"}
    if len(lengths) > 1:
        raise ValueError("the columns t, x, y and p of the events differ in length")
    events = np.empty(lengths.pop(), OWN)
    events["t"] = _microseconds(named["t"], time_unit)
    for axis in "xy":
        events[axis] = _pixels(named[axis], axis)
    events["p"] = _are_on(named["p"])
    return events


def _microseconds(times, unit):
    kind = times.dtype.kind
    if kind in "mM":
        return times.astype(f"{kind}8[us]").astype(np.int64)
    if kind not in "iuf":
        raise TypeError(f"the times of the events are of type {times.dtype}, where numbers are expected")
    if kind == "f":
        _refuse(~np.isfinite(times), times, "t", "is no time")
        # Whole numbers are microseconds, as in files.
        unit = unit or ("s" if np.any(times != np.floor(times)) else "us")
        per_unit = MICROSECONDS.get(unit, 1e-3)
        return np.rint(times.astype(np.float64) * per_unit).astype(np.int64)
    if unit == "ns":
        return (times // 1000).astype(np.int64)
    return times.astype(np.int64) * MICROSECONDS[unit or "us"]


def _pixels(values, axis):
    if values.dtype.kind not in "iufb":
        raise TypeError(f"{axis} of the events is of type {values.dtype}, where numbers are expected")
    _refuse(~((values >= 0) & (values < 65535)), values, axis, "is on no sensor")
    if values.dtype.kind == "f":
        _refuse(values != np.floor(values), values, axis, "is not a whole pixel: undistorted events cannot be used")
    return values.astype(np.uint16)


def _are_on(values):
    if values.dtype.kind not in "iufb":
        raise TypeError(f"p of the events is of type {values.dtype}, where numbers are expected")
    all_ones = np.iinfo(values.dtype).max if values.dtype.kind == "u" else None
    on, off = _polarities(values[:2000].astype(np.float64), all_ones)
    _refuse(~np.isin(values, [on, *off]), values, "p", f"is not a polarity ({on:g} for ON, {off[0]:g} for OFF)")
    return values == on


def _refuse(wrong, values, name, why):
    if wrong.any():
        index = int(np.argmax(wrong))
        raise ValueError(f"event {index}: {name} = {values[index]} {why}")
