"""Runs the commands that a page shows, literally and in its order, in a folder of the page's own.

Code of the kind `sh`, and code within a line that begins with a program's name. What is not run: forms with a word in
capitals (their options must exist), what needs hardware, what takes minutes (its stored result must exist), what
other parts of .ci run. `<!-- given: COMMAND -->` is run and not shown: what the reader brings. `<!-- board: SCENE -->`
before a block of console commands types them on the virtual board; what stands to the right of a command, and in the lines
below that begin with a blank, must come in this order, but for the digits of an RMS and a ratio. `<!-- file: NAME -->` before a block
makes that file of it, `<!-- append: NAME -->` puts it behind what is there.
"""

import functools
import os
import re
import shutil
import subprocess
import time

from .source import LONG, ROOT, shell

SECONDS = 240  # a minute on an idle machine
PROGRAM = re.compile(r"(?:[A-Z_]+=\S+ )?(?:cargo|mdbook|\.ci/\w+|probe-rs|valgrind|STM32_Programmer_CLI)\b")
# A name that stands for others: SCENE, N_PER_V, K. Names of files and chips have small letters or digits.
FORM = re.compile(r"(?<![\w./-])(?:[A-Z][A-Z_]*|[A-Z]+\.[a-z]+)(?![\w-])|(?<!\w)\.\.(?!/)|\.\.?$")
# The name of a command or of an option, in a sentence or table.
NAME = re.compile(r"cargo (?:sim|board)(?: (?:--)?\w+)?$")
# Needs a board, or what the reader has of his own.
HARDWARE = re.compile(r"cargo (?:flash|embed)|probe-rs|STM32_Programmer|openocd|nc |cargo-flash|\(printf")
# Done by .ci/run, .ci/book or nobody: tools of the reader's.
ELSEWHERE = re.compile(
    r"\.ci/|mdbook|valgrind|cargo (?:fmt|clippy|doc|firmware|seal|install|live|sim-files|test --workspace|test -p zwidth --lib"
    r"|bench -p host-sim-bench|(?:test|run)$)"
)
# Of minutes, without a table of figures: what they make is stored beside.
MINUTES = {
    "cargo run --release -p host-sim-bench --bin fixed_point_limits": "docs/figures/fixed-point-limits.csv",
    "cargo board fuzz --instants": "docs/data/fuzz-instants.csv",
    "cargo sim trade identified.toml": "docs/data/trade-plant-paper-1um.csv",
    "cargo sim compare identified.toml": "docs/data/compare-paper-1um.csv",
    **{command: f"docs/data/{next(iter(files.values()))}" for command, files, *_ in LONG.values()},
}


def whole(block):
    """A command that goes on in the next line stands whole in its first, so that line numbers stay."""
    lines = list(block)
    for n in range(len(lines) - 2, -1, -1):
        if lines[n].endswith("\\"):
            lines[n : n + 2] = [f"{lines[n][:-1].rstrip()} {lines[n + 1].strip()}", ""]
    return lines


def shown(text):
    """Line, kind and command of all that the page shows."""
    last = block = None
    for n, line in enumerate(text.split("\n"), 1):
        if line.lstrip().startswith("```"):
            if block is None:
                kind, block, start = line.strip()[3:], [], n + 1
                continue
            if kind == "sh":
                for m, command in enumerate(whole(block), start):
                    if command and not command.startswith("#"):
                        yield m, "block", re.sub(r"\s{2,}#.*", "", command)
            elif last:
                yield start, last[0], (last[1], block)
            last = block = None
        elif block is not None:
            block.append(line)
        elif given := re.fullmatch(r"<!-- given: (.+) -->", line.strip()):
            yield n, "given", given[1]
        elif before := re.fullmatch(r"<!-- (board|file|append): (.+) -->", line.strip()):
            last = before.groups()
        else:
            for command in re.findall(r"`([^`]+)`", line):
                if PROGRAM.match(command) and " " in command:
                    yield n, "run", command


@functools.cache
def usage(program, command):
    binary = {"sim": "host-sim", "board": "virtual-board-cli"}[program]
    ran = shell(f"cargo run --quiet --release --package {binary} -- {command} --help")
    return ran.stdout if ran.returncode == 0 else ""


def form(command):
    """A form: its command and options must exist."""
    words = command.split()
    if words[:2] not in (["cargo", "sim"], ["cargo", "board"]) or len(words) < 3:
        return None
    subcommands = re.findall(r"(?m)^  ([a-z]+) ", usage(words[1], ""))
    help_text = usage(words[1], words[2]) if words[2] in subcommands else "".join(usage(words[1], c) for c in subcommands)
    if words[2].isalpha() and words[2].islower() and words[2] not in subcommands:
        help_text = ""
    if not help_text:
        return f"there is no `cargo {words[1]} {words[2]}`"
    missing = [word for word in words if word.startswith("--") and word.strip("[]") not in help_text]
    return f"`cargo {words[1]} {words[2]}` has no {missing}" if missing else None


@functools.cache
def tests(arguments):
    ran = shell(f"cargo test --quiet {arguments} -- --list --include-ignored")
    return re.findall(r"(?m)^(\S+): test$", ran.stdout) if ran.returncode == 0 else None


def test_exists(command):
    """A test that the page names: it is there, and .ci/run runs it."""
    words, _, options = command.partition(" -- ")
    target = r"(?:-p|--test|--features|--package) \S+|--\S+"
    names = [*re.sub(target, "", words).split()[2:], *(word for word in options.split() if not word.startswith("--"))]
    listed = tests(" ".join(word for word in re.findall(target, words) if word != "--release"))
    if listed is None:
        return "the tests do not build"
    return next((f"no test is named {name}" for name in names if not any(name in test for test in listed)), None)


def invariants(command):
    """.ci/run runs them; here only whether the names are there."""
    only = re.search(r"--only (\S+)", command)
    return f"no property has {only[1]} in its name" if only and only[1] not in shell("cargo invariants --list").stdout else None


def failure(ran):
    """Why a command failed; None: it did not."""
    said = ran.stderr.strip() or ran.stdout.strip() or f"exit code {ran.returncode}"  # `diff` says it on stdout
    return said.split("\n")[-1] if ran.returncode else None


@functools.cache
def build():
    """What the commands need, so that their time is theirs: the simulator, the virtual board, the image."""
    shell("cargo sim --version && cargo board run < /dev/null")


def board(scene, block, folder, environment):
    """Types the commands of a block; what stands to the right of one must come."""
    said = [re.split(r"\s{2,}", line, maxsplit=1) for line in block if line.strip()]
    lines = "".join(f"{words[0]}\n" for words in said if words[0])
    ran = shell(f"cargo board run {scene}", folder, SECONDS, input=lines, env=environment)
    if why := failure(ran):
        return why
    if "error" in ran.stdout:
        return next(line for line in ran.stdout.split("\n") if "error" in line)
    at = 0
    for command, *wanted in said:
        # A position in the scene is said in words.
        for piece in ", ".join(wanted).split(", ") if wanted and not command.startswith("hand ") else []:
            piece = re.sub(r"^(rms|force rms|ratio) .*", r"\1 ", piece)
            found = ran.stdout.find(piece, at)
            if found < 0:
                return f"`{command}` is not answered by {piece!r}: {ran.stdout[at:][:400]!r}"
            at = found
    return None


# Options of a command that its page has; those of all commands stand in docs/files.md.
OPTIONS = {
    "docs/virtual-board.md": ["board run", "board hit", "board walk", "board serve"],
    "docs/lab/invariants.md": ["board fuzz"],
    "docs/lab/campaigns.md": ["board campaign"],
    "docs/telemetry.md": ["sim telemetry", "sim replay"],
}
COMMON = {"--help", "--version", "--elf", "--threads", "--numeric", "--engine", "--out", "--force", "--json", "--parquet"}


def options(name):
    """What the page should have."""
    text, missing = (ROOT / name).read_text(), []
    for command in OPTIONS.get(name, []):
        known = set(re.findall(r"(?m)^ +(--[a-z-]+)", usage(*command.split()))) - COMMON
        if not known:
            missing.append(f"{name}:1: cargo {command} has no options")
        missing += [f"{name}:1: has no `{option}` of cargo {command}" for option in sorted(known)
                    if not re.search(rf"`[^`\n]*{option}\b", text)]
    return missing


def tried(kind, command, folder, environment):
    """Runs what a page shows, or looks whether it is there; why it fails, or None."""
    if kind == "board":
        return board(*command, folder, environment)
    if kind != "given":
        if command in MINUTES:
            return None if (ROOT / MINUTES[command]).exists() else f"{MINUTES[command]} is not there"
        if command.startswith("cargo test"):
            return test_exists(command)
        if command.startswith("cargo invariants"):
            return invariants(command)
        if FORM.search(command) or kind == "run" and NAME.match(command):
            return form(command)
        # build.rs takes it from the root, and this folder stands for the root
        command = re.sub(r"^(ZWIDTH_DEVICE=)(?=\S+\.device )", rf"\1{folder}/", command)
    return failure(shell(command, folder, SECONDS, env=environment))


def run(name):
    """All commands of a page; what failed."""
    build()
    folder = ROOT / "target/pages" / name.replace("/", "-").removesuffix(".md")
    shutil.rmtree(folder, ignore_errors=True)
    for brought in ("scenes", "docs/data", "examples"):
        shutil.copytree(ROOT / brought, folder / brought)
    environment = {**os.environ, "LANG": "C.UTF-8", "ROOT": str(ROOT)}
    failed, count = [], 0
    for line, kind, command in shown((ROOT / name).read_text()):
        if kind in ("file", "append"):
            with (folder / command[0]).open("w" if kind == "file" else "a") as file:
                file.write("\n" * (kind == "append") + "\n".join(command[1]) + "\n")
            continue
        if kind in ("block", "run") and (HARDWARE.match(re.sub(r"^[A-Z_]+=\S+ ", "", command)) or ELSEWHERE.match(command)):
            continue
        begun = time.monotonic()
        try:
            why = tried(kind, command, folder, environment)
        except subprocess.TimeoutExpired:
            why = f"takes more than {SECONDS} s"
        count += 1
        seconds, told = time.monotonic() - begun, "console session" if kind == "board" else command
        if seconds > 5:
            print(f"{name}:{line}: {seconds:.0f} s: {told}")
        if why:
            failed.append(f"{name}:{line}: `{told}` fails: {why}")
    if count:
        print(f"{name}: {count} commands")
    return failed + options(name)
