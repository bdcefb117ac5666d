"""Calibrates an event camera from the events of a moving circle grid."""

from ._evcal import (
    Calibration,
    Camera,
    Error,
    __version__,
    calibrate,
    detect,
    evaluate,
    info,
    read,
    simulate,
)

__all__ = [
    "Calibration",
    "Camera",
    "Error",
    "__version__",
    "calibrate",
    "detect",
    "evaluate",
    "info",
    "read",
    "simulate",
]
