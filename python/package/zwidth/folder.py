"""Studies in a folder, on this machine or on many."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from . import _native

Engine = Literal["lanes", "core"]
Numeric = Literal["fixed", "f64", "f64-rounded"]
Progress = Callable[[int, int], object]

if TYPE_CHECKING:
    import pandas
    import pyarrow
    from distributed import Client, Future

__all__ = ["StudyFailed", "StudyRun", "run_study"]

#: Count of units that a scheduler has at the same time, for each thread of its workers.
AHEAD = 2

#: Time between two checks that the scheduler is still there, s.
LOOK_S = 0.5

Made = tuple[str, str, int, int]


class StudyFailed(RuntimeError):
    """Some units could not be made. The others are in the folder: the same call with ``resume=True`` tries what is missing.

    Attributes
    ----------
    out : Path
        The folder.
    units : mapping of int to str
        The units, and why.
    """

    def __init__(self, out: Path, units: Mapping[int, str]) -> None:
        self.out, self.units = out, dict(units)
        first, why = next(iter(self.units.items()))
        more = "" if len(self.units) == 1 else f" and {len(self.units) - 1} more, see .units"
        super().__init__(f"{out}: unit {first}{more} could not be made: {why}; resume=True tries again")

    def __reduce__(self) -> tuple[type[StudyFailed], tuple[Path, Mapping[int, str]]]:
        return StudyFailed, (self.out, self.units)


@dataclass(frozen=True)
class StudyRun:
    """A study in its folder.

    Attributes
    ----------
    out : Path
        The folder, as ``cargo sim study --out`` writes it.
    measure : str
        ``walk``, ``hit`` or ``sweep``.
    points, units, units_made : int
        How many; of the units how many were made by this call.
    rows, hits, bytes : int
        Of all parts.
    """

    out: Path
    measure: str
    points: int
    units: int
    units_made: int
    rows: int
    hits: int
    bytes: int

    def to_arrow(self) -> pyarrow.Table:
        """All parts as one :class:`pyarrow.Table`; needs pyarrow."""
        import pyarrow

        return pyarrow.concat_tables([_read(part) for part in self._parts()], promote_options="permissive")

    def to_parquet(self, path: str | PathLike[str], *, parts: bool = False) -> None:
        """All parts as one Parquet file; needs pyarrow.

        Parameters
        ----------
        path : str or path
            The file, which is replaced; with `parts` the folder, which is not there yet or empty.
        parts : bool
            A file for each part, all with the same columns: what ``pyarrow.dataset``, Dask, DuckDB and Spark read as one
            table. Only one part is in memory at a time.
        """
        import pyarrow
        from pyarrow import parquet

        if not parts:
            parquet.write_table(self.to_arrow(), path)
            return
        out = Path(path)
        if out.exists() and any(out.iterdir()):
            raise FileExistsError(f"{out} is there already, and not empty")
        out.mkdir(parents=True, exist_ok=True)
        # A column that is empty in one part takes its type from another part.
        schema = pyarrow.unify_schemas([_read(part).schema for part in self._parts()], promote_options="permissive")
        for part in self._parts():
            draft = out / f".{part.stem}.draft"
            parquet.write_table(_read(part).cast(schema), draft)
            draft.rename(out / f"{part.stem}.parquet")

    def _parts(self) -> list[Path]:
        return sorted(self.out.glob("part-*.csv"))

    def to_pandas(self) -> pandas.DataFrame:
        """All parts as a :class:`pandas.DataFrame`; needs pyarrow and pandas."""
        return self.to_arrow().to_pandas()


def _read(part: Path) -> pyarrow.Table:
    from pyarrow import csv

    return csv.read_csv(part, convert_options=csv.ConvertOptions(strings_can_be_null=False))


@lru_cache(maxsize=4)
def _units(text: str, origin: str, folder: Path) -> _native.StudyUnits:
    """Read a study; a process reads each study once."""
    return _native.StudyUnits(text, origin, folder)


def _make(study: tuple[str, str, Path], unit: int, engine: str, numeric: str, threads: int | None) -> Made:
    return _units(*study).make(unit, engine, numeric, threads)


def run_study(
    study: str | PathLike[str] | Mapping[str, Any],
    out: str | PathLike[str],
    *,
    resume: bool = False,
    client: Client | None = None,
    retries: int = 2,
    engine: Engine = "lanes",
    numeric: Numeric = "fixed",
    threads: int | None = None,
    progress: Progress | None = None,
) -> StudyRun:
    """Walk, hit or sweep at every point of a product or list; the results are files, and a run that ends goes on.

    The folder is that of ``cargo sim study``, byte for byte, whoever made its units, in whatever order: either goes on with
    what the other began.

    Parameters
    ----------
    study : path or mapping
        As in :func:`study`.
    out : path
        The folder. One run at a time has it.
    resume : bool
        Go on with a folder: make what is missing. A folder of another study or another program is refused.
    client : distributed.Client, optional
        Units are made by the workers of this Dask cluster, one on each of their threads; without, on this machine, one
        after another on all threads. The workers need the same build of this package, and the scenes' files where they
        are here.
    retries : int
        How often a unit that failed on the cluster is tried again.
    engine, numeric, threads
        As in :func:`walk`; with a client a unit has one thread.
    progress : callable, optional
        Called with the units that are there and the units in all, from this thread; what it raises ends the run.

    Raises
    ------
    ValueError
        A key or value is wrong, or the folder is another study's; the line names it and what is allowed.
    OSError
        The folder cannot be written, on a full disk for example. What is in it stays whole.
    StudyFailed
        Some units could not be made.
    """
    asked = _native.study_text(study)
    place = Path(out)
    folder = _native.StudyFolder(_units(*asked), str(place), resume, numeric)
    missing = folder.missing()
    there = folder.units - len(missing)

    def enter(unit: int, made: Made) -> None:
        nonlocal there
        folder.add(unit, *made)
        there += 1
        if progress is not None:
            progress(there, folder.units)

    if client is None:
        for unit in missing:
            enter(unit, _make(asked, unit, engine, numeric, threads))
    else:
        failed = _on_cluster(client, folder.key, retries, missing, enter, (asked, engine, numeric))
        if failed:
            raise StudyFailed(place, failed)
    rows, hits, size = folder.finish()
    return StudyRun(place, folder.measure, folder.points, folder.units, len(missing), rows, hits, size)


def _on_cluster(
    client: Client,
    key: str,
    retries: int,
    missing: list[int],
    enter: Any,
    how: tuple[tuple[str, str, Path], str, str],
) -> dict[int, str]:
    """Run units on a cluster, a few at a time. Return the units that failed, with the reasons."""
    from concurrent.futures import CancelledError  # raised by all running units when the connection is lost

    from distributed import wait

    asked, engine, numeric = how
    rest = iter(missing)
    under_way: dict[Future[Made], int] = {}
    failed: dict[int, str] = {}

    def begin() -> None:
        for unit in rest:
            future = client.submit(
                _make, asked, unit, engine, numeric, 1, key=f"zwidth-{key[:16]}-{unit}", retries=retries, pure=False
            )
            under_way[future] = unit
            return

    for _ in range(AHEAD * (sum(client.nthreads().values()) or 1)):  # type: ignore[no-untyped-call]
        begin()
    try:
        while under_way and client.status in ("running", "connecting"):
            try:
                done = wait(list(under_way), LOOK_S, "FIRST_COMPLETED").done  # type: ignore[no-untyped-call]
            except TimeoutError:
                continue
            except CancelledError:
                break
            for future in done:
                unit = under_way.pop(future)
                try:
                    made = future.result()
                except Exception as error:  # noqa: BLE001 - whatever a worker raises is a unit that could not be made
                    failed[unit] = f"{type(error).__name__}: {error}"
                else:
                    enter(unit, made)
                begin()
    finally:
        if under_way and client.status == "running":
            client.cancel(list(under_way))  # type: ignore[no-untyped-call]
    failed |= dict.fromkeys([*under_way.values(), *rest], "the scheduler is gone")
    return dict(sorted(failed.items()))
