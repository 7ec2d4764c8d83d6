from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__version__: str
SCENES: list[str]
ESTIMATORS: list[str]

__all__ = [
    "ESTIMATORS",
    "SCENES",
    "Estimator",
    "Scene",
    "StudyFolder",
    "StudyUnits",
    "__version__",
    "agree",
    "compare",
    "decode",
    "explain",
    "grid",
    "hit",
    "identify",
    "identify_plan",
    "linear",
    "peers",
    "replay",
    "study",
    "study_text",
    "sweep",
    "usable",
    "velocity_table",
    "walk",
    "with_estimator",
]

def decode(data: bytes) -> dict[str, Any]: ...
def velocity_table(name: str) -> dict[str, Any]: ...
def with_estimator(scene: Scene, velocity: dict[str, Any], cutoff: float | None) -> Scene: ...

@final
class Scene:
    @staticmethod
    def load(name_or_path: str) -> Scene: ...
    @staticmethod
    def parse(text: str, name: str = "scene") -> Scene: ...
    @property
    def name(self) -> str: ...
    @property
    def text(self) -> str: ...
    def to_toml(self) -> str: ...
    def to_dict(self) -> dict[str, Any]: ...
    def replaced(self, changes: dict[str, Any]) -> Scene: ...
    def __eq__(self, other: object, /) -> bool: ...
    def portable_text(self) -> str: ...

@final
class Estimator:
    def __new__(cls, scene: Scene, cutoff: float | None = None) -> Estimator: ...
    @property
    def needs(self) -> str | None: ...
    @property
    def lsb_m_per_s(self) -> float: ...
    def reset(self) -> None: ...
    def process(
        self,
        counts: NDArray[np.int64],
        force: NDArray[np.int32] | None = None,
        acceleration: NDArray[np.int32] | None = None,
        edge_age: NDArray[np.int64] | None = None,
        edge_up: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.int32]: ...

def hit(
    scene: Scene,
    stiffness: float,
    damping: float,
    cutoff: float | None,
    start_offset: float,
    numeric: str,
    trace: bool,
) -> dict[str, Any]: ...
def walk(
    scene: Scene,
    cutoff: float | None,
    start_offset: float,
    engine: str,
    numeric: str,
    threads: int | None,
) -> dict[str, Any]: ...
def sweep(
    scene: Scene,
    cutoffs: list[float] | None,
    repeat: int,
    engine: str,
    numeric: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def grid(
    scene: Scene,
    cutoffs: list[float] | None,
    dampings: list[float],
    stiffnesses: list[float],
    start_offset: float,
    engine: str,
    numeric: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def linear(
    scene: Scene,
    cutoff: float | None,
    dampings: list[float],
    multirate: bool,
    passivity: bool,
) -> dict[str, Any]: ...
def agree(
    scene: Scene,
    measured: str,
    engine: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def replay(scene: Scene, capture: str, estimator: str | None, cutoff: float) -> dict[str, Any]: ...
def identify(logs: list[str], base: Scene, asked: dict[str, Any]) -> dict[str, Any]: ...
def identify_plan(scene: Scene) -> dict[str, Any]: ...
def compare(
    scene: Scene,
    estimators: list[str] | None,
    damping: float | None,
    budget: int,
    repeat: int,
    engine: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def explain(
    scene: Scene,
    damping: float | None,
    budget: int,
    repeat: int,
    engine: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def peers(
    scene: Scene,
    limits: list[float | str],
    steps: list[float] | None,
    repeat: int,
    engine: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def usable(
    scene: Scene,
    percents: list[float],
    estimators: list[str] | None,
    budget: int,
    repeat: int,
    engine: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def study(
    study: str | dict[str, Any],
    engine: str,
    numeric: str,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def study_text(study: str | dict[str, Any]) -> tuple[str, str, str]: ...

@final
class StudyUnits:
    def __new__(cls, text: str, origin: str, folder: str) -> StudyUnits: ...
    def make(
        self, unit: int, engine: str, numeric: str, threads: int | None
    ) -> tuple[str, str, int, int]: ...

@final
class StudyFolder:
    def __new__(cls, units: StudyUnits, out: str, resume: bool, numeric: str) -> StudyFolder: ...
    @property
    def measure(self) -> str: ...
    @property
    def points(self) -> int: ...
    @property
    def units(self) -> int: ...
    @property
    def key(self) -> str: ...
    def missing(self) -> list[int]: ...
    def add(self, unit: int, key: str, csv: str, rows: int, hits: int) -> None: ...
    def finish(self) -> tuple[int, int, int]: ...
