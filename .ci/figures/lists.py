"""Lists of a page that have to be whole: what the programs have and the page does not name."""

import re

from .source import ROOT


def found(pattern, path, start="", end="\x00"):
    """What the group of the pattern matches, in a part of a file."""
    text = (ROOT / path).read_text()
    text = text.split(start, 1)[1] if start else text
    return re.findall(pattern, text.split(end, 1)[0])


def console():
    """Commands; of `tuning3` to `tuning8` the page names the ends."""
    names = found(r'\(\s*"(\w+)",\s*"[^"]*",', "src/console/command.rs", "static TABLE", "\n};")
    return [rf"`{name}(?: [^`]*)?`" for name in names if not re.fullmatch("tuning[4-7]", name)]


def literally(texts):
    return [re.escape(f"`{text.split('{')[0].rstrip()}") for text in texts]


RECORD = ("src/console/refused.rs", "for BadRecord {", "\n}\n")
LISTS = {
    "ARCHITECTURE.md": lambda: [rf"`{path.name}/" for path in ROOT.iterdir()
                                if path.is_dir() and (path / "Cargo.toml").exists()],
    "CONTRIBUTING.md": lambda: [rf"`\.ci/{path.name}\b" for path in (ROOT / ".ci").iterdir()
                                if path.is_file()],
    "docs/adding-a-board.md": lambda: [
        rf"`{name}`" for name in found(r"\n    (?:const|type|fn) (\w+)", "src/board/f4/mod.rs", "pub trait Wiring", "\n}\n")],
    "docs/device-record.md": lambda: literally(found(r'f(?:\.write_str\(|, )"([^"]+)"', *RECORD)),
    "docs/live.md": lambda: [
        rf"`--{name.replace('_', '-')}\b" for name in found(r"#\[arg\(long[^\n]*\)\]\s+(\w+):", "live/src/main.rs")],
    "docs/settings.md": lambda: literally(found(r'=> "([^"]+)"', "src/store/mod.rs", "for Source {", "\n}\n")),
    "docs/telemetry.md": lambda: [
        rf"(?m)^\| {bit} \| " for bit in found(r"pub const [A-Z_]+: Self = Self\((\d+)\);", "src/telemetry.rs")],
    "docs/tuning.md": console,
}


def wrong(page):
    if page not in LISTS:
        return []
    wanted, text = LISTS[page](), (ROOT / page).read_text()
    if not wanted:
        return [f"{page}:1: .ci/figures/lists.py finds nothing that the page should name"]
    return [f"{page}:1: does not have {pattern}" for pattern in wanted if not re.search(pattern, text)]
