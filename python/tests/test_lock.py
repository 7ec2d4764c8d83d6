"""The wheel is built of the same packages as the command line."""

import re
from importlib import metadata

from conftest import ROOT


def versions(lock: str) -> dict[str, set[str]]:
    text = (ROOT / lock).read_text()
    found: dict[str, set[str]] = {}
    for name, version in re.findall(r'name = "(.+)"\nversion = "(.+)"', text):
        found.setdefault(name, set()).add(version)
    return found


def test_packages_of_both_have_the_same_version() -> None:
    ours, root = versions("python/Cargo.lock"), versions("Cargo.lock")
    both = set(ours) & set(root)
    assert {"libm", "pulp", "nalgebra", "rayon"} <= both
    different = {name: (ours[name], root[name]) for name in both if not ours[name] <= root[name]}
    assert not different, f"cargo update -p NAME --precise VERSION in python/: {different}"


def test_the_version_is_the_simulators() -> None:
    import zwidth

    assert versions("Cargo.lock")["host-sim"] == {zwidth.__version__}


def test_the_wheel_has_the_licence_and_the_stubs() -> None:
    files = {file.name for file in metadata.files("zwidth") or ()}
    assert {"LICENSE-MIT", "LICENSE-APACHE", "_native.pyi", "py.typed"} <= files
