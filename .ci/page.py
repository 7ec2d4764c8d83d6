"""Chromium on the page, and what a person does there: the steps of page.md."""

import atexit
import contextlib
import re
import shutil
import time

from tools import PICTURES, ROOT, check, install_debian, run_with

# What scripts find on the page.
HELP = """
    const at = (selector) => document.querySelector(selector), text = (id) => document.getElementById(id).textContent;
    const typed = () => [...document.querySelectorAll("#lines .person")].map((line) => line.textContent);
    const field = (name) => {
      const item = at(`[data-set=${name}], input#${name}, select#${name}`);
      return { value: item.value, state: item.dataset.state, said: item.closest("label").nextSibling.textContent };
    };"""
FIELDS = ["k", "b", "wall", "push", "cutoff", "estimator"]
# By section: whether at the other page, s, what is done, its words, its script.
STEPS = {
    name: re.findall(r"(?m)^(?!\s)(other )?(?:within (\d+) )?(\w+) ?(.*)((?:\n  .*)*)", steps)
    for name, steps in re.findall(r"(?m)^## (.*)\n((?:(?!## ).*\n)*)", (ROOT / ".ci/page.md").read_text())
}


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
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        self.driver.set_script_timeout(600)
        atexit.register(self.quit)
        self.size(*size)
        self.driver.get(address)
        self.until("zwidth.state && zwidth.state.record")

    def quit(self):
        if self.driver:
            self.driver.quit()
        self.driver = None

    def size(self, wide, tall):
        """Of the page, without the window's frame."""
        self.driver.set_window_size(wide, tall)
        inner_wide, inner_tall = self.js("return [innerWidth, innerHeight]")
        self.driver.set_window_size(2 * wide - inner_wide, 2 * tall - inner_tall)

    def slow_down(self, times):
        self.driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": times})

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
        return self.driver.execute_script(f"{HELP} return (async function () {{ {text} }})(...arguments)", *arguments)

    def judged(self, script):
        """Whether it holds, and what it tells."""
        script = script if "return " in script else f"return window.zwidth && ({script})"
        return self.js(f"const found = await (async () => {{ {script} }})();"
                       "return Array.isArray(found) ? [!!found[0], found[1]] : [!!found, '']")

    def until(self, script, seconds=20):
        """Waits until it holds; what it then tells."""
        end = time.time() + seconds
        while time.time() < end:
            holds, told = self.judged(script)
            if holds:
                return told
            time.sleep(0.02)
        raise SystemExit(f"FAILED: waited {seconds} s for {script}")

    def meets(self, what, script, seconds=20):
        """Waits for it, and says so with what is then there."""
        check(what, True, self.until(script, seconds))

    def follow(self, section, other=None):
        """Does what a section of page.md says."""
        from selenium.webdriver.common.keys import Keys
        for second, seconds, act, words, script in STEPS[section]:
            page = other if second else self
            acts = {
                "send": lambda: page.command(*words.split("; ")),
                "type": lambda: page.type(*words.split("; ")),
                "put": lambda: page.put(*words.partition(" ")[::2]),
                "choose": lambda: page.choose(*words.partition(" ")[::2]),
                "click": lambda: page.click(words),
                "press": lambda: page.press(getattr(Keys, words)),
                "drag": lambda: page.drag(words.split(" ")[0], [map(float, at.split(",")) for at in words.split(" ")[1:]]),
                "size": lambda: page.size(*map(int, words.split(" "))),
                "arm": page.arm, "stop": page.stop, "settled": page.settled, "reload": page.driver.refresh,
                "run": lambda: page.js(words + script),
                "wait": lambda: time.sleep(float(words)),
                "until": lambda: page.until(words + script, int(seconds or 20)),
                "check": lambda: check(words, *page.judged(script)),
                "meets": lambda: page.meets(words, script, int(seconds or 20)),
                "shown": lambda: check(words, not page.wrong_fields(), page.wrong_fields() or ""),
            }
            acts[act]()

    def command(self, *lines):
        """To the board, as the page's buttons do it."""
        self.js("for (const line of arguments) zwidth.link.command(line)", *lines)

    def choose(self, name, value):
        """In a menu or field, as a person does."""
        self.js("const item = document.getElementById(arguments[0]); item.value = arguments[1];"
                "item.dispatchEvent(new Event('change'))", name, value)

    def type(self, *lines):
        from selenium.webdriver.common.keys import Keys
        line = self.find("#line")
        for text in lines:
            line.send_keys(text, Keys.ENTER)
            self.until(f"typed().includes({text!r})")

    def find(self, selector):
        return self.driver.find_element("css selector", selector)

    def field(self, name):
        return self.find(f"[data-set={name}], input#{name}, select#{name}")

    def put(self, name, text):
        """Types into a field, as a person does."""
        from selenium.webdriver.common.keys import Keys
        self.field(name).send_keys(Keys.CONTROL, "a")
        self.field(name).send_keys(text or Keys.BACKSPACE, Keys.ENTER)

    def settled(self):
        """Nothing is under way, and the board has said its settings since."""
        self.until("zwidth.state && zwidth.state.settings && !at('[data-state=sent]')", 30)
        before = self.js("return zwidth.state.settings_after")
        if self.js("return zwidth.state.owner === zwidth.hello.id"):
            self.command("get")
            self.until(f"zwidth.state.settings_after > {before}", 30)
        self.until("!at('[data-state=sent]')", 30)

    def wrong_fields(self):
        """Fields that neither show what `get` says nor are marked with a sentence."""
        settings, *fields = self.js("return [zwidth.state.settings, ...[...arguments].map(field)]", *FIELDS)
        # `push 1 N, push only`: the first one.
        has = dict(reversed(re.findall(r"(?:get |, )(\S+) ([^ ,]+)", settings)))
        is_shown = lambda name, value: value == has[name] if name == "estimator" else float(value) == float(has[name])
        return {name: (field["value"], field["state"], has.get(name)) for name, field in zip(FIELDS, fields)
                if name in has and not (field["state"] in ("refused", "waits") and field["said"])
                and not (re.fullmatch(r"[-a-z0-9.+]+", field["value"]) and is_shown(name, field["value"]))}

    def text(self, name):
        return self.js("return text(arguments[0])", name)

    def press(self, key):
        self.actions().send_keys(key).perform()

    def actions(self, **more):
        from selenium.webdriver.common.action_chains import ActionChains
        return ActionChains(self.driver, **more)

    def drag(self, name, places, hold=False):
        canvas = self.find(f"#{name}")
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
        self.find(selector).click()

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
