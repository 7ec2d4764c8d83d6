"""What the checks share: programs, other people's tools and how they come here, and how a check is told."""

import atexit
import contextlib
import csv
import os
import shutil
import signal
import subprocess
import sys
import time
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


def install_browser():
    """Chromium with its driver, and selenium in a place of its own."""
    install_debian("chromium", "chromium-driver", unless=["chromedriver"])
    run_with("chromium", "selenium==4.36.0", "pillow==12.0.0", "psutil==7.1.3")


class Browser:
    """Chromium on the page."""

    def __init__(self, address, size=(1280, 800)):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service
        options = webdriver.ChromeOptions()
        for option in ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]:
            options.add_argument(option)
        options.add_argument(f"--window-size={size[0]},{size[1]}")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        self.driver.set_script_timeout(60)
        atexit.register(self.quit)
        wide, tall = self.js("return [innerWidth, innerHeight]")
        self.driver.set_window_size(2 * size[0] - wide, 2 * size[1] - tall)
        self.driver.get(address)
        self.until("zwidth.state && zwidth.state.record")

    def quit(self):
        if self.driver:
            self.driver.quit()
        self.driver = None

    def usage(self):
        """Processor time, s, and memory, MB, of all that the browser consists of; what they share counted once."""
        import psutil
        cpu_s = memory = 0
        for process in psutil.Process(self.driver.service.process.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                cpu_s += sum(process.cpu_times()[:2])
                memory += process.memory_full_info().pss
        return cpu_s, memory / 2**20

    def js(self, text, *arguments):
        """What a script returns; it may `await`."""
        return self.driver.execute_script(f"return (async function () {{ {text} }})(...arguments)", *arguments)

    def until(self, text, seconds=20):
        end = time.time() + seconds
        while time.time() < end:
            if self.js(f"return !!(window.zwidth && ({text}))"):
                return
            time.sleep(0.02)
        raise SystemExit(f"FAILED: waited {seconds} s for {text}")

    def meets(self, what, text, seconds=20, said=None):
        """Waits for it, and says so with what is then there."""
        self.until(text, seconds)
        check(what, True, self.js(f"return {said}") if said else "")

    def command(self, *lines):
        """To the board, as the page's buttons do it."""
        self.js("for (const line of arguments) zwidth.link.command(line)", *lines)

    def choose(self, name, value):
        """In a menu or field, as a person does."""
        self.js("const item = document.getElementById(arguments[0]); item.value = arguments[1];"
                "item.dispatchEvent(new Event('change'))", name, value)

    def type(self, *lines):
        from selenium.webdriver.common.keys import Keys
        field = self.find("line")
        for line in lines:
            field.send_keys(line, Keys.ENTER)
            self.until(f"[...document.querySelectorAll('#lines .person')].some(i => i.textContent === {line!r})")

    def find(self, name):
        return self.driver.find_element("id", name)

    def text(self, name):
        return self.js("return document.getElementById(arguments[0]).textContent", name)

    def press(self, key):
        self.actions().send_keys(key).perform()

    def actions(self, **more):
        from selenium.webdriver.common.action_chains import ActionChains
        return ActionChains(self.driver, **more)

    def drag(self, name, places, hold=False):
        canvas = self.find(name)
        wide, tall = canvas.size["width"], canvas.size["height"]
        moves = self.actions(duration=25)
        for n, (x, y) in enumerate(places):
            moves = moves.move_to_element_with_offset(canvas, int((x - 0.5) * wide), int((y - 0.5) * tall))
            moves = moves.click_and_hold() if n == 0 else moves
        (moves if hold else moves.release()).perform()

    def pull(self, millimetres, hold=False):
        """Drags the handle from where it is."""
        low, high, now = self.js("return [zwidth.handle.low, zwidth.handle.high, zwidth.state.record.position_m]")
        place = lambda m: ((m - low) / (high - low), 0.5)
        self.drag("handle", [place(now + (millimetres / 1e3 - now) * n / 15) for n in range(16)], hold)

    def let_go(self):
        self.actions().release().perform()

    def click(self, selector):
        self.driver.find_element("css selector", selector).click()

    def arm(self):
        self.click("[data-do=arm]")
        self.until("zwidth.state.record.armed")

    def at_the_wall(self, what, picture=None):
        """The mouse pulls the handle of the virtual board into the wall."""
        self.type("k 2000", "b 10")
        self.arm()
        self.pull(81, hold=True)
        self.until("zwidth.state.record.contact && zwidth.state.record.force_n < -2 && zwidth.state.record.force_n > -4")
        if picture:
            time.sleep(1)
            self.picture(picture)
        check(what, True, self.text("state"))
        self.let_go()

    def stop(self):
        """By the space bar."""
        self.press(" ")
        self.until("!zwidth.state.record.on")

    def clean(self, *others):
        """Nothing has failed on the pages."""
        errors = [entry for one in (self, *others) for entry in one.driver.get_log("browser") if entry["level"] == "SEVERE"]
        check("no errors on the page", not errors, errors or "")

    def picture(self, name):
        self.driver.save_screenshot(str(PICTURES / f"{name}.png"))
