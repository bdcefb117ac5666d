from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Calibration",
    "Camera",
    "Error",
    "__version__",
    "_columns",
    "_polarities",
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

# A structured array; an array or tensor of N x 4 numbers; a mapping or data frame with the columns t, x, y and p.
_Events: TypeAlias = Any
_Path: TypeAlias = str | PathLike[str]
_Known: TypeAlias = Camera | Calibration | str | PathLike[str]

__version__: Final[str]

class Error(RuntimeError): ...

@final
class Camera:
    def __new__(
        cls,
        model: str,
        parameters: dict[str, float] | Sequence[float],
        sensor: tuple[int, int],
        sigma: Sequence[float] | None = None,
    ) -> Camera: ...
    def __getnewargs__(self) -> tuple[str, list[float], tuple[int, int], list[float] | None]: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> Camera: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    @property
    def model(self) -> str: ...
    @property
    def parameters(self) -> dict[str, float]: ...
    @property
    def sigma(self) -> dict[str, float] | None: ...
    @property
    def sensor(self) -> tuple[int, int]: ...
    @property
    def matrix(self) -> NDArray[np.float64]: ...
    @property
    def distortion(self) -> NDArray[np.float64]: ...
    def project(self, points: ArrayLike) -> NDArray[np.float64]: ...
    def unproject(self, pixels: ArrayLike) -> NDArray[np.float64]: ...
    def undistorted(
        self, alpha: float | None = None, projection: Literal["pinhole", "equidistant"] = "pinhole"
    ) -> Camera: ...
    def undistort_events(
        self,
        events: _Events,
        new_camera: Camera | None = None,
        *,
        subpixel: bool = False,
        columns: str | None = None,
        time_unit: str | None = None,
    ) -> NDArray[np.void]: ...
    def undistort_map(self, new_camera: Camera | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    __hash__: None  # type: ignore[assignment]

@final
class Calibration:
    @property
    def camera(self) -> Camera: ...
    @property
    def sigma(self) -> dict[str, float]: ...
    @property
    def covariance(self) -> NDArray[np.float64]: ...
    @property
    def trajectory(self) -> NDArray[np.void]: ...
    @property
    def grade(self) -> Literal["good", "usable", "not-good"]: ...
    @property
    def verdict(self) -> str: ...
    @property
    def not_calibrated(self) -> list[tuple[str, str]]: ...
    @property
    def report(self) -> str: ...
    def to_dict(self) -> dict[str, Any]: ...
    def write(self, folder: str | PathLike[str], force: bool = False) -> str: ...

def calibrate(
    events: _Path | _Events | Sequence[_Path | _Events],
    *,
    board: str,
    model: str | None = None,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
    settings: str | PathLike[str] | None = None,
    frames: Literal["cross-check", "joint", "only", "ignore"] = "cross-check",
    imu: bool | _Path | None = None,
    gravity: float | None = None,
    with_: _Path | _Events | Sequence[_Path | _Events] | None = None,
    with_sensor: tuple[int, int] | None = None,
    with_stream: str | None = None,
    rolling_shutter: bool = False,
    progress: Callable[[str], object] | None = None,
) -> Calibration: ...
def _columns(
    names: list[str] | None, rows: NDArray[np.float64] | None, given: str | None
) -> tuple[str, str | None]: ...
def _polarities(first: NDArray[np.float64], all_ones: float | None) -> tuple[float, list[float]]: ...
def check(
    events: _Path | _Events,
    *,
    board: str | None = None,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
    settings: _Path | None = None,
) -> dict[str, Any]: ...
def compare(first: _Known, second: _Known) -> dict[str, Any]: ...
def convert(
    events: _Path | _Events,
    output: _Path,
    *,
    to: str | None = None,
    unix_time: bool = False,
    force: bool = False,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
) -> dict[str, Any]: ...
def export(
    calibration: _Known,
    format: str,
    output: _Path | None = None,
    *,
    force: bool = False,
    camera_name: str | None = None,
) -> str | list[Path]: ...
def repeat(
    events: _Path | _Events,
    *,
    board: str,
    runs: int = 10,
    seconds: float = 4.0,
    seed: int = 1,
    model: str | None = None,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
    settings: _Path | None = None,
) -> dict[str, Any]: ...
def detect(
    events: _Path | _Events,
    *,
    board: str,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
    settings: str | PathLike[str] | None = None,
) -> NDArray[np.void]: ...
def evaluate(
    calibration: Camera | Calibration | str | PathLike[str],
    truth: Camera | Calibration | str | PathLike[str],
) -> dict[str, Any]: ...
def info(
    file: str | PathLike[str],
    *,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
) -> dict[str, Any]: ...
def read(
    file: str | PathLike[str],
    *,
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
) -> NDArray[np.void]: ...
def simulate(
    camera: Camera | None = None,
    *,
    board: str = "acircles:9x4:55mm:r17.5mm",
    duration: float = 6.0,
    motion: str = "slow",
    light: str = "default",
    seed: int = 1,
) -> tuple[NDArray[np.void], Camera]: ...
