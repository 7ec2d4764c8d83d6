"""Studies in a folder: that of the command line, byte for byte, whoever made its units and whatever was killed meanwhile."""

import json
import os
import pickle
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, LocalCluster, get_task_stream

import zwidth
from conftest import simulate

#: Kills of each kind, at random instants; `.ci/long dask` asks for more.
KILLS = int(os.environ.get("ZWIDTH_KILLS", "1"))
STUDY = """
measure = "walk"
scenes = ["paper-2um"]
cutoffs_hz = [300, 500, 1000, 1500]
starts_counts = "0:0.1:0.4"
points_per_unit = 1
[product]
walk.stiffness_step_n_per_m = [8000]
walk.damping_step_n_s_per_m = [60]
actuator.latency = [5, 10]
"""
UNITS = 40
DRIVER = """
import sys, zwidth
from distributed import Client
address, study, out, resume = sys.argv[1:]
client = Client(address, timeout=20) if address else None
made = zwidth.run_study(study, out, resume=bool(resume), client=client)
print(made.units_made)
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def whole(study: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The folder as the command line makes it."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert simulate("study", study, "--out", out).returncode == 0
    return read(out)


def read(out: Path) -> dict[str, bytes]:
    """Every file of a folder; of what made it only what has to be the same."""
    files = {path.name: path.read_bytes() for path in sorted(out.iterdir())}
    head = json.loads(files["study.json"])
    for key in ("git_commit", "git_dirty"):  # a test's build may be older than the last commit
        del head[key]
    files["study.json"] = json.dumps(head).encode()
    return files


def test_the_folder_is_that_of_the_command_line(study: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    made = zwidth.run_study(study, tmp_path / "out", progress=lambda done, total: seen.append((done, total)))
    assert read(tmp_path / "out") == whole
    assert (made.units, made.units_made, made.rows) == (UNITS, UNITS, UNITS)
    assert seen == [(n, UNITS) for n in range(1, UNITS + 1)]
    assert made.bytes == sum(len(text) for name, text in whole.items() if name.startswith("part-"))
    table = made.to_arrow()
    assert table.num_rows == UNITS and table.column("point").to_pylist() == list(range(UNITS))
    made.to_parquet(tmp_path / "all.parquet")
    import pyarrow.parquet

    assert pyarrow.parquet.read_table(tmp_path / "all.parquet").equals(table)
    assert list(made.to_pandas()["area_n2_s_per_m2"]) == list(zwidth.study(study).table["area_n2_s_per_m2"])


def test_parts_are_parquet_files_with_the_same_columns(tmp_path: Path) -> None:
    import pyarrow.dataset
    import pyarrow.parquet

    # The second part has no cutoff at all.
    keys = {"measure": "hit", "scenes": ["paper-2um"], "estimators": ["butterworth", "difference"], "cutoffs_hz": [500],
            "stiffnesses": [5e3], "dampings": [20], "points_per_unit": 1}
    made = zwidth.run_study(keys, tmp_path / "out")
    made.to_parquet(tmp_path / "parts", parts=True)
    files = sorted((tmp_path / "parts").iterdir())
    assert [file.stem for file in files] == [part.stem for part in sorted((tmp_path / "out").glob("part-*.csv"))] and len(files) == 2
    schemas = [pyarrow.parquet.read_schema(file) for file in files]
    assert schemas[0].equals(schemas[1])
    table = pyarrow.dataset.dataset(tmp_path / "parts").to_table()
    assert table.equals(made.to_arrow()) and table.column("cutoff_hz").to_pylist() == [500, None]
    with pytest.raises(FileExistsError):
        made.to_parquet(tmp_path / "parts", parts=True)


def test_either_goes_on_with_what_the_other_began(study: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    class Ended(Exception):
        pass

    def end(done: int, _: int) -> None:
        if done == 7:
            raise Ended

    with pytest.raises(Ended):
        zwidth.run_study(study, tmp_path / "out", progress=end)
    with pytest.raises(ValueError, match="holds a study already"):
        zwidth.run_study(study, tmp_path / "out")
    assert simulate("study", study, "--out", tmp_path / "out", "--resume").returncode == 0
    assert read(tmp_path / "out") == whole
    (tmp_path / "out" / "part-00000005.csv").write_text("torn")
    assert zwidth.run_study(study, tmp_path / "out", resume=True).units_made == 1
    assert read(tmp_path / "out") == whole


def test_a_folder_of_another_study_is_refused(study: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    zwidth.run_study(study, tmp_path / "out")
    other = tmp_path / "other.toml"
    other.write_text(STUDY.replace("0.4", "0.3"))
    with pytest.raises(ValueError, match="holds another study: its points or units are others"):
        zwidth.run_study(other, tmp_path / "out", resume=True)
    assert read(tmp_path / "out") == whole


def test_a_unit_of_another_program_is_refused(study: Path, tmp_path: Path) -> None:
    from zwidth import _native

    units = _native.StudyUnits(*_native.study_text(str(study)))
    folder = _native.StudyFolder(units, str(tmp_path / "out"), False, "fixed")
    key, csv, rows, hits = units.make(3, "lanes", "fixed", 1)
    with pytest.raises(ValueError, match="unit 4 was made of another study or by another program"):
        folder.add(4, key, csv, rows, hits)
    folder.add(3, key, csv, rows, hits)
    assert 3 not in folder.missing() and len(folder.missing()) == UNITS - 1


def test_a_full_disk_ends_it_and_it_goes_on(study: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    def little() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        largest = len(whole["study.json"]) + 300  # the manifest grows beyond that
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    out = tmp_path / "out"
    command = [sys.executable, "-c", DRIVER, "", str(study), str(out)]
    ended = subprocess.run([*command, ""], preexec_fn=little, capture_output=True, text=True)
    assert ended.returncode == 1 and ended.stderr.strip().splitlines()[-1].startswith("OSError: "), ended.stderr
    there = len((out / "manifest.jsonl").read_text().splitlines())
    assert 0 < there < UNITS
    ended = subprocess.run([*command, "resume"], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (0, f"{UNITS - there}\n"), ended.stderr
    assert read(out) == whole


class Cluster:
    """A scheduler and two workers on loopback, each a process that can be killed."""

    def __init__(self, folder: Path) -> None:
        self.file, self.folder = folder / "scheduler.json", folder
        self.file.unlink(missing_ok=True)
        self.scheduler = self.begin("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(self.file))
        self.workers = [self.worker() for _ in range(2)]
        end = time.monotonic() + 60
        while not self.file.exists() or not self.file.read_text():
            assert time.monotonic() < end, "no scheduler"
            time.sleep(0.05)
        self.address = json.loads(self.file.read_text())["address"]
        with Client(self.address) as client:
            client.wait_for_workers(2, timeout=60)

    def begin(self, kind: str, *words: str) -> subprocess.Popen[bytes]:
        log = (self.folder / "cluster.log").open("ab")
        return subprocess.Popen([sys.executable, "-m", f"distributed.cli.dask_{kind}", *words], stdout=log, stderr=log)

    def worker(self) -> subprocess.Popen[bytes]:
        return self.begin(
            "worker", "--scheduler-file", str(self.file), "--nthreads", "1", "--no-nanny", "--no-dashboard",
            "--local-directory", str(self.folder),
        )

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    made = Cluster(folder)
    try:
        yield made
    finally:
        made.end()


def test_workers_make_the_same_bytes(study: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as local, Client(local) as client:
        made = zwidth.run_study(study, tmp_path / "out", client=client)
        assert made.units_made == UNITS
        assert read(tmp_path / "out") == whole
        assert zwidth.run_study(study, tmp_path / "out", client=client, resume=True).units_made == 0


@pytest.mark.skipif(KILLS < 2, reason="half a minute on idle cores; .ci/long dask asks for it")
def test_the_engine_costs_little_beside_units_of_seconds(tmp_path: Path) -> None:
    def spread(n: int, low: float, high: float) -> list[float]:
        return [low + (high - low) * i / (n - 1) for i in range(n)]

    keys = {"measure": "hit", "scenes": ["paper-2um"], "cutoffs_hz": spread(10, 300, 3000), "stiffnesses": spread(400, 1e3, 1e5),
            "dampings": spread(300, 0, 300), "points_per_unit": 150_000}
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as local, Client(local) as client:
        with get_task_stream(client) as seen:
            begun = time.monotonic()
            zwidth.run_study(keys, tmp_path / "out", client=client)
            wall_s = time.monotonic() - begun
    parts = [part for task in seen.data for part in task["startstops"] if part["action"] == "compute"]
    units_s = [part["stop"] - part["start"] for part in parts]
    overhead = 2 * wall_s / sum(units_s) - 1
    print(f"{len(units_s)} units of {min(units_s):.2f} to {max(units_s):.2f} s on 2 workers in {wall_s:.2f} s: overhead {100 * overhead:.1f} %")
    assert len(units_s) == 8 and min(units_s) > 3
    assert overhead < 0.05


def test_units_that_cannot_be_made_are_named(tmp_path: Path) -> None:
    asked: dict[str, Any] = {
        "measure": "walk",
        "scenes": ["paper-2um"],
        "cutoffs_hz": [500],
        "points_per_unit": 1,
        "product": {"wall.position_m": [0.07, 1.5], "walk.damping_step_n_s_per_m": [100]},
    }
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, processes=False) as local, Client(local) as client:
        with pytest.raises(zwidth.StudyFailed, match="unit 1 could not be made: ValueError: .*resume=True") as failed:
            zwidth.run_study(asked, tmp_path / "out", client=client, retries=1)
    assert list(failed.value.units) == [1]
    assert pickle.loads(pickle.dumps(failed.value)).units == failed.value.units
    assert (tmp_path / "out" / "part-00000000.csv").exists()


@pytest.mark.parametrize("victim", ["worker", "scheduler", "driver"])
def test_a_kill_loses_nothing(victim: str, study: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    dice = random.Random(victim)
    for n in range(KILLS):
        out = tmp_path / f"out-{n}"
        with cluster(tmp_path) as made:
            driver = subprocess.Popen(
                [sys.executable, "-c", DRIVER, made.address, str(study), str(out), ""],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )
            units = dice.randrange(UNITS - 4)
            end = time.monotonic() + 60
            while not (out / "manifest.jsonl").exists() or (out / "manifest.jsonl").read_text().count("\n") < units:
                assert time.monotonic() < end and driver.poll() is None, driver.communicate()
                time.sleep(0.002)
            time.sleep(dice.random() * 0.05)
            {"worker": made.workers[0], "scheduler": made.scheduler, "driver": driver}[victim].kill()
            if victim == "worker":
                made.workers.append(made.worker())
            said, why = driver.communicate(timeout=120)
        if victim == "worker":
            assert driver.returncode == 0, why
            assert said == f"{UNITS}\n"
        else:
            assert driver.returncode != 0
            if victim == "scheduler":
                assert "StudyFailed" in why and "resume=True tries again" in why, why
            entered = (out / "manifest.jsonl").read_text().count("\n")
            again = zwidth.run_study(study, out, resume=True)
            assert again.units_made == UNITS - entered  # what was entered is not made again
        assert read(out) == whole
