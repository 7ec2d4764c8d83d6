"""What `.ci/browser` asks of the fields and buttons of the page: they show what is in force, or say what they show."""

import contextlib
import itertools
import json
import random
import re
import socket
import time

from tools import Browser, check

# A field of the page by the name that `get` has for it.
FIELDS = {"k": "[data-set=k]", "b": "[data-set=b]", "wall": "[data-set=wall]", "push": "[data-set=push]",
          "cutoff": "#cutoff", "estimator": "#estimator"}
STATE = """
    const at = (item) => document.querySelector(item);
    const found = {};
    for (const [name, item] of Object.entries(arguments[0])) {
      const field = at(item);
      found[name] = [field.value, field.dataset.state, field.closest('label').nextSibling.textContent];
    }
    return { fields: found, settings: zwidth.state.settings };"""


# Lines that went to the board.
TYPED = "[...document.querySelectorAll('#lines .person')]"


def state_is(name, state):
    return f"document.querySelector({FIELDS[name]!r}).dataset.state === {state!r}"


def field(browser, name):
    return browser.driver.find_element("css selector", FIELDS[name])


def put(browser, name, text):
    """Types into a field, as a person does."""
    from selenium.webdriver.common.keys import Keys
    field(browser, name).send_keys(Keys.CONTROL, "a")
    field(browser, name).send_keys(text or Keys.BACKSPACE, Keys.ENTER)


def seen(browser, name):
    """Value, state and sentence of a field."""
    return browser.js(STATE, FIELDS)["fields"][name]


def settled(browser):
    """Nothing is under way, and the board has said its settings since."""
    browser.until("zwidth.state && zwidth.state.settings && !document.querySelector('[data-state=sent]')", 30)
    before = browser.js("return zwidth.state.settings_after")
    if browser.js("return zwidth.state.owner === zwidth.hello.id"):
        browser.command("get")
        browser.until(f"zwidth.state.settings_after > {before}", 30)
    browser.until("!document.querySelector('[data-state=sent]')", 30)


def wrong_fields(browser):
    """Fields that neither show what `get` says nor are marked with a sentence."""
    found = browser.js(STATE, FIELDS)
    # `push 1 N, push only`: the first one.
    has = dict(reversed(re.findall(r"(?:get |, )(\S+) ([^ ,]+)", found["settings"])))
    is_shown = lambda name, value: value == has[name] if name == "estimator" else float(value) == float(has[name])
    return {name: (value, state, has.get(name)) for name, (value, state, said) in found["fields"].items()
            if name in has and not (state in ("refused", "waits") and said)
            and not (re.fullmatch(r"[-a-z0-9.+]+", value) and is_shown(name, value))}


def fields(browser):
    """What is typed, what is refused."""
    browser.command("disarm", "k 0", "b 0", "push 1")
    browser.until("zwidth.settings.k === 0 && zwidth.settings.b === 0 && zwidth.settings.push === 1")
    names = browser.js("return [...document.getElementById('estimator').options].map(({ value }) => value)")
    check("the menu has the estimators of the image", names == browser.js("return zwidth.state.estimators") and
          0 < len(names) < browser.js("return zwidth.hello.estimators.length"), names)
    put(browser, "b", "2,5")
    browser.until("zwidth.settings.b === 2.5")
    check("2,5 is 2.5", seen(browser, "b")[0] == "2.5")
    lines = browser.js(f"return {TYPED}.length")
    put(browser, "push", "")
    put(browser, "k", "2.000,5")
    check("an emptied field comes back to what is in force", seen(browser, "push")[:2] == ["1", ""])
    check("what is no number is refused", seen(browser, "k")[1:] == ["refused", "allowed a number"])
    check("neither sends anything", browser.js(f"return {TYPED}.length") == lines)
    put(browser, "wall", "9999")
    browser.until(state_is("wall", "refused"))
    check("a refused value is marked, with the board's sentence", "allowed" in seen(browser, "wall")[2], seen(browser, "wall"))
    put(browser, "wall", "9999")
    browser.meets("typed again it is sent again", f"{TYPED}.filter(i => i.textContent === 'wall 9999').length === 2")
    put(browser, "wall", "")
    put(browser, "k", "")
    check("and an emptied field shows what is in force", not wrong_fields(browser), wrong_fields(browser) or "")
    browser.command("b 10", "k 2000")
    browser.until("zwidth.settings.k === 2000")
    browser.arm()
    browser.choose("estimator", "difference")
    browser.until(state_is("estimator", "refused"))
    check("a menu whose choice is refused shows what is in force, and why", seen(browser, "estimator")[0] == "butterworth"
          and "envelope" in seen(browser, "estimator")[2], seen(browser, "estimator"))
    browser.command("disarm")
    browser.until("!zwidth.state.record.on")
    browser.command("load")
    settled(browser)
    browser.js("const field = document.querySelector('[data-set=k]'); field.value = '300'; field.dispatchEvent(new Event('change'));"
               "document.querySelector('[data-do=load]').click()")
    browser.until("document.querySelector('#keep .said').textContent.startsWith('ok load')")
    settled(browser)
    check("a value that is taken and taken back is not shown", not wrong_fields(browser), wrong_fields(browser) or "")


def first_minute(browser, orders):
    """The minute of docs/live.md, in that many of its 24 orders."""
    acts = {"arm": lambda: browser.click("[data-do=arm]"), "K": lambda: put(browser, "k", "2000"),
            "B": lambda: put(browser, "b", "10"), "cutoff": lambda: put(browser, "cutoff", "1000")}
    every = list(itertools.permutations(acts))
    for order in every[::len(every) // orders]:
        browser.command("disarm", "k 0", "b 0", "cutoff 1500")
        browser.until("!zwidth.state.record.on && zwidth.settings.k === 0 && zwidth.settings.b === 0 && zwidth.settings.cutoff === 1500")
        for act in order:
            acts[act]()
        browser.until("zwidth.state.record.armed && zwidth.settings.k === 2000 && zwidth.settings.b === 10 && zwidth.settings.cutoff === 1000")
        settled(browser)
        marked = [name for name in ("k", "b", "cutoff") if seen(browser, name)[1]]
        check(f"the first minute: {', '.join(order)}", not wrong_fields(browser) and not marked, marked or "")
    # The question may wait: the page answers, and the force stays on.
    browser.find("unlock").click()
    time.sleep(3)
    check("a page that asks is not silent", browser.js("return zwidth.state.record.armed && !zwidth.state.record.unlocked"))
    browser.click("#sure [value=allow]")
    browser.until("zwidth.state.record.unlocked")
    browser.command("disarm")
    browser.until("!zwidth.state.record.on")
    browser.arm()
    # What waits does not outlive the force.
    browser.command("k 0", "b 0")
    browser.until("zwidth.settings.b === 0")
    put(browser, "k", "2000")
    browser.until(state_is("k", "waits"))
    browser.click("[data-do=load]")
    browser.until(state_is("k", "refused"))
    check("what is loaded ends what waits", seen(browser, "k")[2] != "")
    put(browser, "k", "2000")
    browser.until(state_is("k", "waits"))
    browser.stop()
    browser.until("!document.querySelector('[data-set=k]').dataset.state")
    check("a stop ends what waits", seen(browser, "k")[0] == "0")


def reset(address):
    """Of a served board, by its port for gdb."""
    with socket.create_connection(address.split(":"), timeout=10) as gdb, contextlib.suppress(OSError):
        gdb.sendall(b"+$k#6b")
        gdb.settimeout(5)
        while gdb.recv(100):
            pass


VALUES = {"k": ["2000", "0", "40000", "1e9", "-5", "", "2,5", "x", "900"], "b": ["10", "0", "25", "1e6", "", "1,5", "-1"],
          "wall": ["0.07", "0,06", "1e9", "", "-2"], "push": ["1", "2,5", "", "99"],
          "cutoff": ["1000", "1500", "0", "1e6", "", "200", "317"]}


def random_sequences(program, gdb, sequences, seed=1):
    """Whatever is done, in the end each field shows what is in force, or says what it shows."""
    dice = random.Random(seed)
    pages = [Browser(program.line)]
    for number in range(sequences):
        done = []
        for _ in range(dice.randrange(3, 9)):
            page = dice.choice(pages)
            act = dice.choice(["field"] * 8 + ["button"] * 4 + ["menu", "slide", "line", "stop", "reload", "tab", "reset", "control"])
            owns = page.js("return !document.querySelector('[data-do=arm]').disabled")
            done.append(act)
            if act == "field" and owns:
                name = dice.choice(list(VALUES))
                done[-1] = (name, dice.choice(VALUES[name]))
                if field(page, name).is_displayed() and field(page, name).is_enabled():
                    put(page, *done[-1])
            elif act == "button" and owns:
                done[-1] = dice.choice(["zero", "arm", "disarm", "save", "load", "hit", "stop"])
                page.js("document.querySelector(`[data-do=${arguments[0]}]`).click()", done[-1])
            elif act == "menu" and owns:
                done[-1] = dice.choice(["butterworth", "first-order", "difference"])
                page.choose("estimator", done[-1])
            elif act == "slide" and owns:
                page.js("const slide = document.getElementById('slide'); slide.value = arguments[0];"
                        "for (const name of ['input', 'change']) slide.dispatchEvent(new Event(name))", dice.random())
            elif act == "line" and owns:
                done[-1] = dice.choice(["k 1500", "b 12", "unlock envelope", "clear", "period 5", "period 10"])
                page.command(done[-1])
            elif act == "stop":
                page.press(" ")
            elif act == "reload":
                page.driver.refresh()
                page.until("zwidth.state && zwidth.state.record", 30)
            elif act == "tab":
                if len(pages) == 1:
                    pages.append(Browser(program.line))
                else:
                    pages.pop(dice.randrange(2)).quit()
            elif act == "control":
                for one in pages:
                    one.js("document.querySelector('#control button')?.click()")
                    time.sleep(0.2)
            elif act == "reset":
                reset(gdb)
            time.sleep(dice.choice([0, 0, 0.05, 0.4]))
        time.sleep(0.3)
        for page in pages:
            settled(page)
        time.sleep(0.3)
        for page in pages:
            if wrong_fields(page):
                raise SystemExit(f"FAILED: sequence {number} of seed {seed}, {done}: {wrong_fields(page)}")
    check(f"after each of {sequences} random sequences every field shows what is in force, or is marked", True,
          f"{len(pages)} pages at the end")
    pages[0].clean(*pages[1:])
    for page in pages:
        page.quit()


def looks(browser):
    """Console, save, small windows, idle."""
    browser.command(*["version"] * 40)
    browser.until("[...document.querySelectorAll('#lines li')].filter(i => i.textContent.startsWith('ok version')).length === 40")
    browser.js("""
        const { state, link } = zwidth, text = `error: ${"a refusal with its reason ".repeat(20)}`;
        link.tell("state", { ...state, stopped: [], lines: [{ number: 0, from: "board", text }] });""")
    at_end = "const list = document.getElementById('lines'); return list.scrollHeight - list.scrollTop - list.clientHeight < 5"
    time.sleep(0.2)
    check("the console shows its end when a message makes it lower", browser.js(at_end))
    browser.type("status")
    browser.until("document.querySelector('#lines').textContent.includes('ok status')")
    check("and goes on to follow", browser.js(at_end))
    browser.js("document.getElementById('lines').scrollTop = 0")
    time.sleep(0.2)
    browser.type("faults")
    check("and stays where a person has scrolled", browser.js("return document.getElementById('lines').scrollTop === 0"))
    browser.js("document.getElementById('lines').scrollTop = 1e6; document.getElementById('why').textContent = ''")
    for _ in range(2):
        browser.click("[data-do=save]")
        browser.until("document.querySelector('#keep .said').textContent !== 'save …'", 10)
        check("a save says its end", browser.js("return document.querySelector('#keep .said').textContent") == "ok save")
    browser.js("document.querySelector('#spans button').click()")
    browser.until("zwidth.plots.plots[2].scales.y.max <= 0.0011")
    labels = browser.js("return zwidth.plots.plots.map((plot) => plot.axes[1]._values)")
    check("no two labels of an axis are alike", all(len(set(axis)) == len(axis) > 1 for axis in labels), labels[2])
    said = browser.js("""
        const { state, link } = zwidth, say = (on) => {
          link.tell("state", { ...state, lines: [], stopped: [], record: { ...state.record, on, saturated: true } });
          return document.getElementById("flags").textContent.includes("saturated");
        };
        return [say(false), say(true), say(false)];""")
    check("nothing is saturated with the force off", said == [False, True, False], said)
    size = browser.driver.get_window_size()
    wide, tall = browser.js("return [innerWidth, innerHeight]")
    browser.driver.set_window_size(1024 + size["width"] - wide, 600 + size["height"] - tall)
    time.sleep(0.5)
    heights = browser.js("return ['handle', 'plots', 'pair'].map((name) => document.getElementById(name).parentElement.clientHeight && document.getElementById(name).clientHeight)")
    check("at 1024 x 600 nothing collapses, heights", heights[0] == 92 and heights[1] >= 280 and heights[2] == 190 and
          browser.js("return document.getElementById('handle-figure').clientHeight") >= 92, heights)
    browser.driver.set_window_size(size["width"], size["height"])


def silent(live, Owner, Socket):
    """Sockets that take nothing and answer nothing."""
    program = live()
    owner = Owner(program)
    browser = Browser(program.line)
    for line in ["k 200", "b 2", "arm"]:
        owner.send(json.dumps({"type": "command", "line": line}))
    browser.until("zwidth.state.record.armed")
    time.sleep(3)
    check("a page that answers keeps the force on", browser.js("return zwidth.state.record.armed && zwidth.state.owner !== zwidth.hello.id"))
    owner.fall_silent()
    begun = time.time()
    browser.until("zwidth.state.owner === null && !zwidth.state.record.on", 10)
    check("one that falls silent has lost control within 3 s, with the force off, s", time.time() - begun < 3, f"{time.time() - begun:.1f}")
    browser.js("document.querySelector('#control button').click()")
    browser.until("zwidth.state.owner === zwidth.hello.id")
    check("and another page can take it", not browser.js("return zwidth.state.record.on"))
    many = [Socket(program) for _ in range(15)]
    check("all places are taken by sockets that read nothing", all(one.status == 101 for one in many) and Socket(program).status == 503)
    time.sleep(3)
    many += [Socket(program) for _ in range(15)]
    check("after 3 s they have lost them", all(one.status == 101 for one in many))
    browser.quit()
    program.end()
