"""What a board's console answers, as results."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .table import Tabular

Floats = NDArray[np.float64]

__all__ = ["BoardHit", "BoardSelfTest", "BoardStatus", "BoardWalk"]

#: Additional values in the line of a hit by the criterion ``quiet``.
_QUIET = r"(?:, force rms (?P<force>\S+) N(?: m)?, ratio (?P<ratio>\S+))?"


def _read(pattern: str, line: str) -> re.Match[str]:
    found = re.fullmatch(pattern, line)
    if found is None:
        raise ValueError(line.removeprefix("error: "))
    return found


@dataclass(frozen=True)
class BoardStatus:
    """How things stand on a board.

    Attributes
    ----------
    state : str
        ``"off"``, ``"sign test"``, ``"ramping in"``, ``"armed"`` or ``"fault"``.
    fault : int or None
        Code of the latched fault.
    fault_text : str or None
        Its name.
    activity : str
        ``"idle"``, ``"hit"``, ``"walk"``, ``"calibration"`` or ``"pulses"``.
    sample : int
        Newest output's sample since the board's reset.
    position_counts, velocity_counts_per_sample, force_percent, code
        Of that output; force in per cent of full scale.
    zeroed, contact, stop_closed, supply_good, settings_valid, unlocked : bool
        Facts.
    """

    state: str
    fault: int | None
    fault_text: str | None
    activity: str
    sample: int
    position_counts: int
    velocity_counts_per_sample: float
    force_percent: float
    code: int
    zeroed: bool
    contact: bool
    stop_closed: bool
    supply_good: bool
    settings_valid: bool
    unlocked: bool

    @property
    def on(self) -> bool:
        """Whether the output is on: armed, or on the way there."""
        return self.state in ("sign test", "ramping in", "armed")

    @property
    def armed(self) -> bool:
        """Whether sign test and ramp are over and the full force acts."""
        return self.state == "armed"

    @classmethod
    def _of(cls, line: str) -> BoardStatus:
        found = _read(
            r"ok status (?P<state>[^,]+), fault (?:none|(?P<fault>\d+) \((?P<text>.+?)\)), (?P<activity>\w+), "
            r"sample (?P<sample>\d+), position (?P<position>\S+) counts, velocity (?P<velocity>\S+) counts/sample, "
            r"force (?P<force>\S+) %, code (?P<code>\S+)(?P<facts>(?:, [a-z ]+)+)",
            line,
        )
        facts = found["facts"].removeprefix(", ").split(", ")
        words = ("zeroed", "in contact", "stop closed", "supply good", "settings valid", "envelope unlocked")
        zeroed, contact, stop, supply, valid, unlocked = (word in facts for word in words)
        return cls(
            state=found["state"],
            fault=None if found["fault"] is None else int(found["fault"]),
            fault_text=found["text"],
            activity=found["activity"],
            sample=int(found["sample"]),
            position_counts=int(found["position"]),
            velocity_counts_per_sample=float(found["velocity"]),
            force_percent=float(found["force"]),
            code=int(found["code"]),
            zeroed=zeroed,
            contact=contact,
            stop_closed=stop,
            supply_good=supply,
            settings_valid=valid,
            unlocked=unlocked,
        )


@dataclass(frozen=True)
class BoardHit:
    """One hit, as the board has judged it.

    Attributes
    ----------
    verdict : str
        ``"stable"``, ``"unstable"`` or ``"no_contact"``.
    rms, mean : float
        RMS about the mean, and mean position, over the window, to the 12 digits that the console says.
    unit : str
        ``"m"``; ``"rad"`` of a rotary device.
    port_taken_j, port_given_j : float
        What the wall has taken in the last contact, and the most that it has given in one, by its force and the counts, J.
    force_rms : float or None
        By the criterion ``quiet``: RMS of the force about its mean, N or N m, at the push that decides.
    penetration_ratio : float or None
        By the criterion ``quiet``: K times the mean penetration, over the mean force of the wall, if it has any.
    """

    verdict: str
    rms: float
    mean: float
    unit: str
    port_taken_j: float
    port_given_j: float
    force_rms: float | None
    penetration_ratio: float | None

    @property
    def stable(self) -> bool:
        """Whether the wall counts as stable."""
        return self.verdict == "stable"

    @property
    def rms_m(self) -> float:
        """RMS, m; a rotary device has none."""
        return self._metres(self.rms)

    @property
    def mean_m(self) -> float:
        """Mean position, m; a rotary device has none."""
        return self._metres(self.mean)

    def _metres(self, value: float) -> float:
        if self.unit != "m":
            raise ValueError(f"this board speaks {self.unit}: see rms, mean and unit")
        return value

    @classmethod
    def _of(cls, line: str) -> BoardHit:
        hit = r"ok hit ([a-z ]+), rms (\S+) (m|rad), mean (\S+) (m|rad), taken (\S+) J, given (\S+) J" + _QUIET
        found = _read(hit, line)
        return cls(
            verdict=found[1].replace(" ", "_"),
            rms=float(found[2]),
            mean=float(found[4]),
            unit=found[3],
            port_taken_j=float(found[6]),
            port_given_j=float(found[7]),
            force_rms=None if found["force"] is None else float(found["force"]),
            penetration_ratio=None if found["ratio"] in (None, "none") else float(found["ratio"]),
        )


@dataclass(frozen=True, eq=False)
class BoardWalk(Tabular):
    """The boundary of the stable walls, as the board has walked it.

    Attributes
    ----------
    damping, stiffness : ndarray of float
        Points of the boundary, in the order in which they came.
    hit_damping, hit_stiffness, hit_rms : ndarray of float
        Every hit's wall and RMS.
    hit_verdict : ndarray of str
        Every hit's verdict.
    area : float
        Area under the boundary.
    ended_by : str
        Why it ends where it does.
    units : tuple of str
        Of K, B, RMS and area: N/m, N s/m, m and N^2 s/m^2, or those of a rotary device.
    """

    damping: Floats
    stiffness: Floats
    hit_damping: Floats
    hit_stiffness: Floats
    hit_rms: Floats
    hit_verdict: NDArray[np.str_]
    area: float
    ended_by: str
    units: tuple[str, str, str, str]

    def __post_init__(self) -> None:
        for values in vars(self).values():
            if isinstance(values, np.ndarray):
                values.flags.writeable = False

    def columns(self) -> dict[str, Any]:
        return {"damping": self.damping, "stiffness": self.stiffness}

    @classmethod
    def _of(cls, lines: Sequence[str]) -> BoardWalk:
        hit = r"walk hit \d+: k (\S+) ([^,]+), b (\S+) ([^,]+), ([a-z ]+), rms (\S+) (\w+)" + _QUIET
        hits = [_read(hit, line) for line in lines if line.startswith("walk hit ")]
        point = r"walk boundary \d+: k (\S+) [^,]+, b (\S+) [^,]+"
        points = [_read(point, line) for line in lines if line.startswith("walk boundary ")]
        over = _read(r"ok walk over, area (\S+) ([^,]+), peak .+, hits (\d+), points (\d+), ended by (\w+)", lines[-1])
        if (len(hits), len(points)) != (int(over[3]), int(over[4])):
            raise ConnectionError(f"lines of the walk are lost: {len(hits)} hits and {len(points)} points came")
        return cls(
            damping=np.array([float(point[2]) for point in points]),
            stiffness=np.array([float(point[1]) for point in points]),
            hit_damping=np.array([float(hit[3]) for hit in hits]),
            hit_stiffness=np.array([float(hit[1]) for hit in hits]),
            hit_rms=np.array([float(hit[6]) for hit in hits]),
            hit_verdict=np.array([hit[5].replace(" ", "_") for hit in hits], dtype=np.str_),
            area=float(over[1]),
            ended_by=over[5],
            units=(hits[0][2], hits[0][4], hits[0][7], over[2]),
        )


@dataclass(frozen=True)
class BoardSelfTest:
    """The board's test of its own parts.

    Attributes
    ----------
    parts : mapping of str to str
        What was said of each: ``pass`` or ``fail``, and figures or the reason.
    passed : bool
        Whether every part has passed.
    """

    parts: Mapping[str, str]
    passed: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", MappingProxyType(dict(self.parts)))

    def __reduce__(self) -> tuple[type[BoardSelfTest], tuple[dict[str, str], bool]]:
        return BoardSelfTest, (dict(self.parts), self.passed)

    @classmethod
    def _of(cls, lines: Sequence[str]) -> BoardSelfTest:
        if lines[-1] != "ok selftest":
            _read(r"error: selftest: \d+ of \d+ failed", lines[-1])
        said = [line.removeprefix("selftest ").partition(": ") for line in lines[:-1]]
        return cls({part: text for part, _, text in said}, lines[-1] == "ok selftest")
