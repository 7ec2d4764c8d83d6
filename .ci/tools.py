"""What the checks share: programs, other people's tools and how they come here, and how a check is told."""

import argparse
import atexit
import csv
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "figures"
# Where the programs are: of .ci/run those that its tests were built with.
PROGRAMS = ROOT / os.environ.get("PROGRAMS", "target/release")
TOOLS = ROOT / "target/tools"
BOARDS = sorted(path.stem.replace("_", "-") for path in (ROOT / "src/board").glob("*.rs") if path.stem != "mod")
passed = 0


def run(*words, folder=ROOT, **more):
    """What a program says that must hold."""
    done = subprocess.run([str(word) for word in words], cwd=folder, text=True, stdout=subprocess.PIPE, check=False, **more)
    if done.returncode:
        raise SystemExit(f"error: {' '.join(map(str, words))}: ended with {done.returncode}\n{done.stdout}")
    return done.stdout


def listed(name):
    """The rows of a list of .ci; one with the word BOARD stands for each board."""
    with (ROOT / ".ci" / name).open(newline="") as file:
        return [{key: cell.replace("BOARD", board) for key, cell in row.items()} for row in csv.DictReader(file)
                for board in (BOARDS if "BOARD" in row["command"] else [""])]


def one_of(known):
    """The type of an argument that is one of these; `choices` refuses none at all."""
    def asked(word):
        if word not in known:
            raise argparse.ArgumentTypeError(f"{word} is none, allowed {', '.join(known)}")
        return word
    return asked


def sysroot(folder=ROOT):
    return Path(run("rustc", "--print", "sysroot", folder=folder).strip()).resolve()


def install_target(target, folder=ROOT):
    """What the pinned tool chain lacks: with RUSTUP_AUTO_INSTALL=0 nothing comes by itself."""
    if not (sysroot(folder) / "lib/rustlib" / target).is_dir():
        run("rustup", "target", "add", target, folder=folder)


def cargo_tool(package, version, *words):
    """A program of crates.io, in target/tools."""
    run("cargo", "install", package, "--version", f"={version}", "--locked", "--quiet", "--root", TOOLS, *words)
    return TOOLS / "bin" / package


class Program:
    """A program whose first line on stdout is an address."""

    def __init__(self, *command, **more):
        self.process = subprocess.Popen(list(map(str, command)), cwd=ROOT, stdout=subprocess.PIPE, text=True, **more)
        atexit.register(self.process.kill)
        self.line = self.process.stdout.readline().strip()

    def memory_mb(self):
        import psutil
        return psutil.Process(self.process.pid).memory_info().rss / 2**20

    def end(self, how=signal.SIGINT):
        if self.process.poll() is None:
            self.process.send_signal(how)
        return self.process.wait(timeout=20)


def install_debian(*packages, unless=()):
    """By name, unless these programs are there; the lists of a fresh machine are old or empty."""
    if not unless or not all(map(shutil.which, unless)):
        run("apt-get", "update", "-qq")
        run("apt-get", "install", "-y", "-qq", *packages)


def python_with(name, *packages):
    """The programs of a Python of its own with these packages of PyPI, in target/tools/NAME."""
    place = TOOLS / name
    if not (place / "bin/python").exists():
        if subprocess.run([sys.executable, "-m", "venv", place], stdout=2, check=False).returncode:
            install_debian("python3-venv")
            run(sys.executable, "-m", "venv", place)
        run(place / "bin/python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages)
    return place / "bin"


def run_with(name, *packages):
    """The program that was called, by that Python."""
    python = python_with(name, *packages) / "python"
    if Path(sys.prefix).resolve() != (TOOLS / name).resolve():
        os.execv(python, [python, *sys.argv])


def build(*words):
    """The release programs, where no others are given."""
    if "PROGRAMS" not in os.environ:
        run("cargo", "build", "--quiet", "--release", *words)


def check(what, holds, said=""):
    global passed
    if not holds:
        raise SystemExit(f"FAILED: {what} {said}")
    passed += 1
    print(f"ok {what}{f': {said}' if said != '' else ''}", flush=True)
