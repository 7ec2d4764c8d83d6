"""Messages that docs/troubleshooting.md quotes: the programs say them, and what the board refuses by stands there."""

import functools
import re

from .source import ROOT

PAGE = "docs/troubleshooting.md"
# What is between pieces of a message: `..`, and names and values in its place.
BETWEEN = re.compile(r"\.\.+| is(?= \.\.)|\([\w.]+\)|\b(?:KEY|VALUE|SCENE|A|B)\b(?::\d+:)?|\b\d[\d.,]*\b")
# What the operating system says.
SYSTEM = "No such file or directory"
# A quoted message is words; a command, a key or a file name is none.
MESSAGE = re.compile(r"[a-z'?:,.-]+(?: [\w'?:,.()-]+){2,}")


@functools.cache
def said():
    """The text of all programs, each string in one line, what they put in as `{}`."""
    folders = ("src", "host-sim", "virtual-board/src")
    files = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.rs") if "target" not in path.parts)
    text = "\n".join(path.read_text() for path in files)
    return re.sub(r"\\\n\s*", "", text).replace('\\"', '"')


def pieces(message):
    return [piece.strip(" :;,?.") for piece in BETWEEN.split(message) if len(piece.strip(" :;,?.")) > 5]


def wrong():
    """What the page quotes and no program says; what the board says and the page does not have."""
    page, found = (ROOT / PAGE).read_text(), []
    for n, line in enumerate(page.split("\n"), 1):
        if not line.startswith("| "):
            continue
        for message in re.findall(r"`([^`]+)`", line.split(" | ")[0]):
            if not MESSAGE.search(message) or message.startswith("cargo "):
                continue
            missing = [piece for piece in pieces(message) if piece not in said() and piece != SYSTEM]
            if missing:
                found.append(f"{PAGE}:{n}: no program says {missing[0]!r}")
    refusals = (ROOT / "src/safety/records.rs").read_text().split("impl Refusal")[1].split("\n}\n")[0]
    for text in re.findall(r'=> "([^"]+)"', refusals):
        if f"`{text}" not in page:
            found.append(f"{PAGE}:1: the board says {text!r}, the page does not")
    return found
