"""What the checks with other people's tools share: how they come here, and how a check is told."""

import atexit
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "figures"
# Where the programs are: of .ci/run those that its tests were built with.
PROGRAMS = ROOT / os.environ.get("PROGRAMS", "target/release")
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


def build(*packages, features=()):
    """The release programs, where no others are given."""
    if "PROGRAMS" not in os.environ:
        words = [word for package in packages for word in ("--package", package)]
        subprocess.run(["cargo", "build", "--quiet", "--release", *words, *(["--features", ",".join(features)] if features else [])],
                       cwd=ROOT, check=True)


def check(what, holds, said=""):
    global passed
    if not holds:
        raise SystemExit(f"FAILED: {what} {said}")
    passed += 1
    print(f"ok {what}{f': {said}' if said != '' else ''}", flush=True)


def install_browser():
    """Chromium with its driver, and selenium in a place of its own."""
    if not shutil.which("chromedriver"):
        install_debian("chromium", "chromium-driver")
    run_with("browser", "selenium==4.36.0", "pillow==12.0.0")


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
        atexit.register(self.quit)
        wide, tall = self.js("return [innerWidth, innerHeight]")
        self.driver.set_window_size(2 * size[0] - wide, 2 * size[1] - tall)
        self.driver.get(address)
        self.until("zwidth.state && zwidth.state.record")

    def quit(self):
        if self.driver:
            self.driver.quit()
        self.driver = None

    def processes(self):
        """All that the browser consists of."""
        parents = {}
        for status in Path("/proc").glob("[0-9]*/stat"):
            try:
                parents[int(status.parent.name)] = int(status.read_text().rsplit(")", 1)[1].split()[1])
            except (FileNotFoundError, ProcessLookupError):
                continue
        found = [self.driver.service.process.pid]
        for parent in found:
            found += [child for child, of in parents.items() if of == parent]
        return found[1:]

    def cpu_s(self):
        """Processor time of all of them, s."""
        ticks = 0
        for process in self.processes():
            try:
                ticks += sum(map(int, Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[11:13]))
            except (FileNotFoundError, ProcessLookupError):
                continue
        return ticks / os.sysconf("SC_CLK_TCK")

    def memory_mb(self):
        """Memory of all of them, what they share counted once, MB."""
        kb = 0
        for process in self.processes():
            try:
                kb += int(re.search(r"Pss:\s+(\d+)", Path(f"/proc/{process}/smaps_rollup").read_text())[1])
            except (FileNotFoundError, ProcessLookupError, TypeError):
                continue
        return kb / 1024

    def js(self, text, *arguments):
        return self.driver.execute_script(text, *arguments)

    def until(self, text, seconds=20):
        end = time.time() + seconds
        while time.time() < end:
            if self.js(f"return !!(window.zwidth && ({text}))"):
                return
            time.sleep(0.02)
        raise SystemExit(f"FAILED: waited {seconds} s for {text}")

    def type(self, *lines):
        from selenium.webdriver.common.keys import Keys
        field = self.find("line")
        for line in lines:
            field.send_keys(line, Keys.ENTER)
            self.until(f"[...document.querySelectorAll('#lines .person')].some(i => i.textContent === {line!r})")

    def find(self, name):
        from selenium.webdriver.common.by import By
        return self.driver.find_element(By.ID, name)

    def text(self, name):
        return self.js("return document.getElementById(arguments[0]).textContent", name)

    def press(self, key):
        from selenium.webdriver.common.action_chains import ActionChains
        ActionChains(self.driver).send_keys(key).perform()

    def drag(self, name, places, hold=False):
        from selenium.webdriver.common.action_chains import ActionChains
        canvas = self.find(name)
        wide, tall = canvas.size["width"], canvas.size["height"]
        moves = ActionChains(self.driver, duration=25)
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
        from selenium.webdriver.common.action_chains import ActionChains
        ActionChains(self.driver).release().perform()

    def arm(self):
        self.find("force").find_element("css selector", "[data-do=arm]").click()
        self.until("zwidth.state.record.armed")

    def picture(self, name):
        if name:
            self.driver.save_screenshot(str(PICTURES / f"{name}.png"))
