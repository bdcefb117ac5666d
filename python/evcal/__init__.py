"""Calibrates an event camera from the events of a printed board."""

from ._evcal import (
    Calibration,
    Camera,
    Error,
    __version__,
    calibrate,
    check,
    compare,
    convert,
    detect,
    evaluate,
    export,
    info,
    read,
    repeat,
    simulate,
)

__all__ = [
    "Calibration",
    "Camera",
    "Error",
    "__version__",
    "calibrate",
    "check",
    "compare",
    "convert",
    "detect",
    "evaluate",
    "export",
    "info",
    "read",
    "repeat",
    "simulate",
]
