from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Final, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

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

__version__: Final[str]

class Error(RuntimeError): ...

@final
class Camera:
    def __new__(
        cls, model: str, parameters: dict[str, float] | Sequence[float], sensor: tuple[int, int]
    ) -> Camera: ...
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
    def undistort_events(self, events: NDArray[np.void], new_camera: Camera | None = None) -> NDArray[np.void]: ...
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
    def grade(self) -> Literal["good", "usable", "not-good"]: ...
    @property
    def verdict(self) -> str: ...
    @property
    def report(self) -> str: ...
    def to_dict(self) -> dict[str, Any]: ...
    def write(self, folder: str | PathLike[str], force: bool = False) -> str: ...

def calibrate(
    events: str | PathLike[str] | NDArray[np.void] | Sequence[str | PathLike[str] | NDArray[np.void]],
    *,
    board: str,
    model: str = "radtan",
    sensor: tuple[int, int] | None = None,
    columns: str | None = None,
    time_unit: str | None = None,
    stream: str | None = None,
    settings: str | PathLike[str] | None = None,
    frames: Literal["witness", "joint", "only", "ignore"] = "witness",
    progress: Callable[[str], object] | None = None,
) -> Calibration: ...
def detect(
    events: str | PathLike[str] | NDArray[np.void],
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
