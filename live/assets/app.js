// The page: display of the board's state, and controls for a person.
import { link } from "./connect.js";
import { Console } from "./console.js";
import { Field, number } from "./field.js";
import { Handle } from "./handle.js";
import { Plane } from "./plane.js";
import { Plots, SIGNALS } from "./plots.js";
import { saveFigures, saveRows } from "./save.js";
import { Units } from "./units.js";

const three = (value) => +value.toPrecision(3);
const by = (id) => document.getElementById(id);
const plots = new Plots(by("plots"), by("spectrum"), by("phase"));
const handle = new Handle(by("handle"), (message) => link.send(message));
const plane = new Plane(by("plane"), (point, last) => propose(point, last));
const log = new Console(by("lines"), by("type"), by("line"), (line) => link.command(line));

let units = new Units();
let hello = null, now = null, settings = {}, walked = "", frame = {}, frames = 0, span = 5, paused = false;
// True until the lines from before this page have come.
let backlog = true;

// Stop: it comes before all other handlers of the page.
let stops = Date.now();
const stopAt = new Map();
let armed = null; // count of stops when Arm was pressed, until its reply comes; null: no Arm waits
function stop() {
  const id = ++stops;
  stopAt.set(id, performance.now());
  handle.release();
  armed = null;
  const sent = link.send({ type: "stop", id });
  by("stopped").textContent = sent ? "stop sent …" : "NOT CONNECTED: use the wired stop.";
}
by("stop").onpointerdown = (event) => { event.preventDefault(); stop(); };
by("stop").onclick = (event) => { if (event.detail === 0) stop(); };
window.addEventListener("keydown", (event) => {
  const typing = event.target.matches?.("#line");
  if (event.key === "Escape" || event.key === " " && !typing) {
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) stop();
  }
}, { capture: true });

// Theme: the system's theme until the user selects one.
const dark = matchMedia("(prefers-color-scheme: dark)");
function paint(theme) {
  document.documentElement.dataset.theme = theme;
  plots.make();
  plane.draw();
}
by("theme").onclick = () => paint(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
dark.onchange = () => paint(dark.matches ? "dark" : "light");
paint(dark.matches ? "dark" : "light");

// Time.
for (const seconds of [.1, .5, 2, 5, 20, 60]) {
  const button = document.createElement("button");
  button.textContent = seconds < 1 ? `${seconds * 1000} ms` : `${seconds} s`;
  button.dataset.span = seconds;
  button.onclick = () => { span = seconds; look(); };
  by("spans").append(button);
}
function look() {
  for (const button of by("spans").children) button.classList.toggle("now", +button.dataset.span === span);
  link.send({ type: "view", span_s: span, columns: plots.columns(), paused });
}
by("pause").onclick = () => { paused = !(now?.view.paused ?? false); look(); };
new ResizeObserver(() => look()).observe(by("plots"));

// Trigger.
let level = 0;
function armTrigger() {
  const typed = number(by("level").value);
  if (Number.isFinite(typed)) level = typed;
  by("level").value = level;
  const kind = by("trigger").value;
  const unit = units[SIGNALS[kind]?.name];
  by("level-label").hidden = !unit;
  by("again").hidden = kind === "off";
  by("level-unit").textContent = unit?.unit ?? "";
  paused = false;
  if (!unit) return link.send({ type: "trigger", on: kind });
  const lsb = [hello.resolution_m, hello.resolution_m * hello.rate_hz / 65536, hello.full_scale_n / 2 ** 30][kind];
  const above = { signal: +kind, level: Math.round(level / unit.times / lsb), rising: by("rising").value === "1" };
  link.send({ type: "trigger", on: { level: above } });
}
for (const id of ["trigger", "level", "rising"]) by(id).onchange = armTrigger;
by("again").onclick = armTrigger;

// Buttons and fields send console commands. The board's reply is shown below the buttons.
const asked = new Map();
function ask(line, said, stops) {
  const sent = link.command(line, stops);
  asked.set(line, said);
  tell(said, sent ? `${line} …` : "not connected", !sent);
}
function tell(said, text, isBad) {
  said.textContent = text;
  said.classList.toggle("bad", isBad);
}
for (const button of document.querySelectorAll("[data-do]")) {
  const said = button.closest("fieldset").querySelector(".said");
  button.onclick = () => {
    const stops = button.dataset.do === "arm" ? now.stops : null;
    armed = stops;
    ask(button.dataset.do, said, stops);
  };
}
const send = (line) => link.command(line);
const fields = {};
for (const input of document.querySelectorAll("[data-set]")) {
  const name = input.dataset.set;
  fields[name] = new Field(input, send, () => name, /^[kb]$/.test(name) ? /envelope|arming/ : /arming/);
}
fields.estimator = new Field(by("estimator"), send, () => "estimator");
fields.tuning = new Field(by("cutoff"), send, () => tuned()?.frequency ? "cutoff" : "tuning", /arming/);
const each = (does) => Object.values(fields).forEach(does);

// If the envelope does not allow the present K, K waits, so that the force can be switched on without it. Not after a
// stop that came since Arm was pressed.
const STIFFNESS = /envelope: (no k|k at this b)/;
function armWithout(why) {
  const stops = armed;
  armed = null;
  if (!STIFFNESS.test(why) || !(fields.k.inForce > 0)) return;
  fields.k.wait(0, why);
  ask("arm", document.querySelector("#force .said"), stops);
}

// Dragging the cutoff on a logarithmic scale: sent a few times per second, and at the end.
const CUTOFFS = [20, 4000]; // Hz
by("slide").oninput = () => slide(false);
by("slide").onchange = () => slide(true);
let slid = 0, sliding = false;
function slide(last) {
  const time = performance.now();
  const hertz = +(CUTOFFS[0] * (CUTOFFS[1] / CUTOFFS[0]) ** by("slide").value).toPrecision(3);
  sliding = !last;
  by("cutoff").value = hertz;
  if (!last && time - slid < 200) return;
  slid = time;
  by("why").textContent = "";
  fields.tuning.set(hertz);
}
let percent = 10;
by("percent").onchange = () => {
  const typed = number(by("percent").value);
  if (Number.isFinite(typed)) percent = typed;
  by("percent").value = percent;
};
by("calibrate").onclick = () => ask(`calibrate ${percent}`, by("result"));
by("unlock").onclick = (event) => {
  event.preventDefault();
  if (!now?.record?.unlocked) by("sure").show();
};
// Not by `confirm`: while it waits, the page can neither stop nor answer the server, and so loses control.
by("sure").onclose = () => {
  if (by("sure").returnValue === "allow") link.command("unlock envelope");
  by("sure").returnValue = "";
};
by("switch").onchange = () => link.send({ type: "emergency_stop", open: by("switch").checked });
by("svg").onclick = () => saveFigures(plots, plane, `${hello?.scene} on ${hello?.board}, ${new Date().toISOString()}: ${now?.settings ?? ""}`);
by("csv").onclick = async () => { const why = await saveRows(plots, link); if (why) alarm(why); };

// Dragging a point: the gains are sent in the order that stays inside the envelope, a few times per second and at the
// end.
let proposed = 0;
function propose({ k, b }, last) {
  if (!("k" in settings)) return;
  const time = performance.now();
  if (!last && time - proposed < 200) return;
  proposed = time;
  by("why").textContent = "";
  const lines = [`k ${+k.toPrecision(6)}`, `b ${+b.toPrecision(6)}`];
  if (k > (settings.k ?? 0)) lines.reverse();
  for (const line of lines) link.command(line);
}

function tuned() { return hello?.estimators.find(({ name }) => name === settings.estimator)?.tuning; }

// `ok get k 0 N/m, b 0 N s/m, wall 0.07 m, ..`: names and values from the reply.
function parse(text) {
  const found = {};
  for (const part of text.replace(/^ok get /, "").split(", ")) {
    const [, name, value] = /^(full scale|\S+) (\S+)/.exec(part) ?? [];
    if (name && !(name in found)) found[name] = Number.isNaN(+value) ? value : +value;
  }
  return found;
}

function showSettings(text, after) {
  const tuning = tuned();
  by("cutoff-label").hidden = !tuning;
  const value = tuning && settings[tuning.name];
  if (tuning) {
    by("cutoff-label").firstChild.textContent = `${tuning.name} `;
    by("cutoff-label").querySelector("i").textContent = tuning.unit;
  }
  for (const [name, field] of Object.entries(fields)) field.show(name === "tuning" ? value : settings[name], after);
  by("slide").hidden = !tuning?.frequency;
  if (value > 0 && !sliding) by("slide").value = Math.log(value / CUTOFFS[0]) / Math.log(CUTOFFS[1] / CUTOFFS[0]);
  if (!units.settings.test(text)) {
    alarm(`The board says other units than those of the scene ${hello.scene}: give cargo live the scene of its record.`);
    settings = {};
    return;
  }
  plane.wall = { k: settings.k ?? 0, b: settings.b ?? 0 };
  plane.draw();
  const question = `${settings.estimator} ${value ?? 1000}`;
  if (settings.estimator && question !== walked) {
    walked = question;
    by("area").textContent = "walking …";
    by("quiet-area").textContent = "–";
    link.send({ type: "predict", estimator: settings.estimator, cutoff_hz: value ?? 1000 });
  }
}

function alarm(text) {
  by("alarm").hidden = !text;
  by("alarm").textContent = text;
}

// Another board or another device: clear everything of the previous one.
link.on("fresh", () => {
  [settings, frame, now] = [{}, {}, null];
  each((field) => field.forget());
  plane.clear();
});
link.on("hello", (message) => {
  hello = message;
  plots.rate = hello.rate_hz;
  units = plots.units = plane.units = handle.units = new Units(hello.radius_m);
  Object.assign(handle, { fullScale: hello.full_scale_n, low: hello.travel_m[0], high: hello.travel_m[1] });
  for (const item of document.querySelectorAll("[data-unit]")) item.textContent = units[item.dataset.unit].unit;
  by("speed").textContent = units.say("slow", hello.noise_speed_m_per_s, three);
  plots.make();
  by("board").textContent = `${hello.board} · ${hello.scene}${hello.virtual ? " · virtual" : ""}`;
  frame.estimators = null;
  by("switch-label").hidden = by("handle-figure").hidden = !hello.virtual;
  by("legend").innerHTML = "";
  for (const [name, colour] of [["envelope", "--green"], ["predicted", "--blue"], ["quiet (dashed)", "--blue"], ["walk", "--violet"]]) {
    const item = document.createElement("b");
    item.textContent = `■ ${name}`;
    item.style.color = `var(${colour})`;
    by("legend").append(item);
  }
  walked = frame.settings = frame.after = "";
  frame.other_record = null;
  backlog = true;
  log.clear();
  alarm("");
  look();
});
link.on("lost", (why) => {
  alarm(why);
  by("state").textContent = "not connected";
  by("state").className = "chip fault";
  hold(false);
});
link.on("refused", ({ line, why }) => {
  by("why").textContent = why;
  by("why").className = "bad";
  hear(line, `error: ${why}`, 0);
});

// Shows the reply to a command.
function hear(line, text, number) {
  each((field) => field.hear(line, text, number));
  const said = asked.get(line);
  if (!said) return;
  asked.delete(line);
  const isBad = !text.startsWith("ok");
  // The force's state is shown above.
  tell(said, isBad ? text.replace(/^error: /, "") : said.closest("#force") ? "" : text, isBad);
  if (line === "arm" && armed !== null) armWithout(isBad ? text : "");
}

// A page without control shows the settings and cannot change them.
function hold(mine) {
  handle.allowed = plane.allowed = mine;
  for (const item of document.querySelectorAll("#left button, #left input, #left select, #line")) {
    if (!["svg", "csv"].includes(item.id) && !item.closest("#device, #studies")) item.disabled = !mine;
  }
  if (!mine) {
    each((field) => field.release());
    by("sure").close();
    [armed, sliding] = [null, false];
    for (const said of asked.values()) tell(said, "no reply", true);
    asked.clear();
  }
}

// The estimators of the image, and the present one. All estimators are listed until the board sends its list.
function showEstimators(names) {
  const known = hello.estimators.map(({ name }) => name);
  const list = [...new Set([...(names.length ? names : known), ...(settings.estimator ? [settings.estimator] : [])])];
  if (`${list}` === frame.estimators) return;
  frame.estimators = `${list}`;
  by("estimator").replaceChildren(...list.map((name) => new Option(name)));
  by("estimator").value = fields.estimator.inForce ?? settings.estimator ?? "";
}
link.on("predicted", ({ predicted }) => {
  if (`${predicted.estimator} ${predicted.cutoff_hz}` !== walked) return;
  plane.predicted = units.predicted(now?.other_record ? { ...predicted, envelope: [] } : predicted);
  by("area").textContent = predicted.error ?? units.say("area", predicted.area, three);
  by("quiet-area").textContent = predicted.error || !predicted.quiet_area ? "–" : units.say("area", predicted.quiet_area, three);
  by("delay").textContent = predicted.delay_s == null ? "–" : `${(predicted.delay_s * 1e3).toFixed(3)} ms`;
  by("noise").textContent = predicted.noise_m_per_s == null ? "–" : units.say("slow", predicted.noise_m_per_s, three);
  plane.draw();
});
link.on("state", (state) => {
  const before = now?.record;
  now = state;
  const { record, owner, asking, pages, handle: seen, view } = state;
  for (const { id, ms } of state.stopped) {
    if (!stopAt.has(id)) continue;
    const here = performance.now() - stopAt.get(id);
    stopAt.delete(id);
    by("stopped").textContent = `Force off ${here.toFixed(0)} ms after the key (board ${ms.toFixed(0)} ms). No substitute for the wired stop.`;
    by("stopped").dataset.ms = here;
  }
  log.add(state.lines);
  for (const { from, text, answers, number } of state.lines) {
    if (from === "board") plane.hear(text);
    if (backlog) continue;
    if (answers) hear(answers, text, number);
    // Waiting fields are out of date now.
    if (answers === "load" || from === "server" && text === "the board was reset") each((field) => field.giveUp());
    if (from !== "board") continue;
    if (/^(ok hit [su n]|hit push |walk |error: (hit|walk)|calibrate|ok calibrate over|ok walk over)/.test(text)) tell(by("result"), text.replace(/^ok /, ""), text.startsWith("error"));
    if (text.startsWith("error")) { by("why").textContent = text.replace(/^error: /, ""); by("why").className = "bad"; }
    else if (/^ok [kb] /.test(text)) { by("why").textContent = text.replace(/^ok /, ""); by("why").className = "quiet"; }
  }
  backlog = false;
  const mine = owner === hello?.id;
  hold(mine && !state.lost);
  if (!record) handle.allowed = plane.allowed = false;
  const control = by("control");
  const wanted = mine ? asking ? "give" : "mine" : owner ? asking === hello?.id ? "asked" : "ask" : "take";
  if (control.dataset.now !== wanted) {
    control.dataset.now = wanted;
    control.replaceChildren();
    const button = document.createElement("button");
    if (wanted === "mine") control.textContent = "";
    else {
      button.textContent = { give: `Hand over to page ${asking}`, ask: "Ask for control", asked: "Asked …", take: "Take control" }[wanted];
      button.disabled = wanted === "asked";
      button.onclick = () => link.send({ type: wanted === "give" ? "give" : "ask" });
      control.append(button);
    }
  }
  // Also if nothing else has changed: a field may show more than the board has taken.
  if (state.other_record !== frame.other_record) {
    frame.other_record = state.other_record;
    alarm(state.other_record);
  }
  if (state.settings && (state.settings !== frame.settings || state.settings_after !== frame.after)) {
    frame.after = state.settings_after;
    settings = parse(state.settings);
    showEstimators(state.estimators);
    showSettings(state.settings, state.settings_after);
  }
  if (hello) showEstimators(state.estimators);
  // Waiting fields are sent again after a change of settings. They are not if the envelope is unlocked or the force has
  // gone off.
  if (record?.unlocked) each((field) => field.giveUp());
  if (before?.on && !record?.on) each((field) => { if (field.state === "waits") field.release(); });
  if (state.settings !== frame.settings || record?.armed && !before?.armed) each((field) => field.again());
  frame.settings = state.settings;
  const chip = by("state");
  if (state.lost) {
    alarm(`The board is gone: ${state.lost}`);
    chip.textContent = "no board";
    chip.className = "chip fault";
  } else if (record) {
    const fault = hello?.faults.find(({ code }) => code === record.fault);
    chip.textContent = fault ? `FAULT ${fault.code}` : record.armed ? "ARMED: FORCE ON" : record.on ? "ARMING" : "FORCE OFF";
    chip.className = `chip ${fault ? "fault" : record.on ? "on" : ""}`;
    const facts = [record.contact && "contact", record.on && record.saturated && "saturated", record.changing && "changing", !record.zeroed && "not zeroed", !record.stop_closed && "stop open", record.unlocked && "ENVELOPE UNLOCKED"];
    by("flags").textContent = facts.filter(Boolean).join(" · ");
    by("unlock").checked = record.unlocked;
    by("switch").checked = !record.stop_closed;
    const panel = by("fault");
    panel.hidden = !fault;
    if (fault && panel.dataset.code !== `${fault.code}`) {
      panel.dataset.code = fault.code;
      panel.replaceChildren();
      const [head, text, clear, box] = ["h2", "p", "button", "button"].map((name) => document.createElement(name));
      head.textContent = `Fault ${fault.code}: ${fault.text}`;
      text.textContent = fault.remedy;
      clear.textContent = "Clear";
      clear.onclick = () => link.command("clear");
      box.textContent = "What happened";
      box.onclick = () => link.command("faults");
      panel.append(head, text, clear, " ", box);
    } else if (!fault) delete panel.dataset.code;
  }
  const [found, dropped, garbage] = state.counts;
  by("stats").textContent = `${seen ? `${seen.speed.toFixed(2)} × real time · ` : ""}${pages} page${pages > 1 ? "s" : ""}${mine ? "" : " · watching"}${dropped ? ` · ${dropped} of ${found + dropped} frames lost` : ""}${garbage ? ` · ${garbage} garbage bytes` : ""}`;
  by("pause").textContent = view.paused ? "Go on" : "Pause";
  paused = view.paused;
  by("met").textContent = view.met == null ? (by("trigger").value === "off" ? "" : "waiting …") : `triggered at ${(view.met * (plots.seen?.step ?? 1) / plots.rate).toFixed(4)} s`;
  // All of it is shown: the page is alive.
  link.send({ type: "alive", number: state.number });
});
for (const name of ["curves", "spectra", "phase"]) link.on(name, (bytes) => { frame[name] = bytes; });

function draw() {
  requestAnimationFrame(draw);
  if (frame.curves) { plots.draw(frame.curves); frame.curves = null; frames++; drawHandle(); }
  if (frame.spectra) { plots.drawSpectra(frame.spectra); frame.spectra = null; }
  if (frame.phase) { plots.drawPhase(frame.phase); frame.phase = null; }
}
function drawHandle() {
  const record = now?.record;
  if (!record || !hello?.virtual) return;
  handle.draw({ position: record.position_m, wall: settings.wall == null ? hello.wall_m : settings.wall / units.wall.times, force: record.force_n, finger: now.handle?.finger_n, on: record.on, contact: record.contact });
}
requestAnimationFrame(draw);
hold(false); // until the board is there
// For tests and measurements from outside the page.
window.zwidth = { get frames() { return frames; }, get state() { return now; }, get settings() { return settings; }, get hello() { return hello; }, alarm, plots, plane, handle, link };
