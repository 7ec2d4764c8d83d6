"""What the checks with other people's tools share: how they come here, and how a check is told."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
passed = 0


def install_debian(*packages):
    """By name; the lists of a fresh machine are old or empty."""
    subprocess.run(["apt-get", "update", "-qq"], check=True, stdout=2)
    subprocess.run(["apt-get", "install", "-y", "-qq", *packages], check=True, stdout=2)


def run_with(name, *packages):
    """The program that was called, by a Python of its own with these packages of PyPI, in target/tools/NAME."""
    place = ROOT / "target" / "tools" / name
    python = place / "bin" / "python"
    if not python.exists():
        if subprocess.run([sys.executable, "-m", "venv", str(place)], stdout=2).returncode:
            install_debian("python3-venv")
            subprocess.run([sys.executable, "-m", "venv", str(place)], check=True, stdout=2)
        subprocess.run([str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", *packages], check=True, stdout=2)
    if Path(sys.prefix).resolve() != place.resolve():
        os.execv(str(python), [str(python), *sys.argv])


def check(what, holds, said=""):
    global passed
    if not holds:
        raise SystemExit(f"FAILED: {what} {said}")
    passed += 1
    print(f"ok {what}{f': {said}' if said != '' else ''}", flush=True)
