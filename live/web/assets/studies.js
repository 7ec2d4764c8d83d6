// The simulator's commands for the page's device: sweep, grid, hit and design, shared by the workers. Their tables have
// the form of `cargo sim`.
import { BOARD } from "./connect.js";
import { context } from "./plots.js";
import { give } from "./save.js";
import { isSame, told, TUNINGS } from "./settings.js";

const GRID = 24; // walls along each axis
const BUDGET = 100; // filters that a search tries, in about a minute

export class Studies {
  constructor(link, make) {
    Object.assign(this, { link, make, pool: link.pool, busy: false, areas: null });
    this.buttons = {
      sweep: make("button", { id: "sweep", title: "the area over the cutoffs of the scene's [sweep], by the scene's own estimator" }, "Sweep cutoffs"),
      grid: make("button", { id: "grid", title: "every wall of the plane, hit once" }, "Map walls"),
      hit: make("button", { id: "both", title: "the wall in force, hit once with the scene's push by a board of its own and by the simulator" }, "Hit, both"),
      design: make("button", { id: "design", title: `the best of ${BUDGET} filters, in about a minute` }, "Design filter"),
    };
    for (const [name, button] of Object.entries(this.buttons)) button.onclick = () => this.run(name);
    this.end = make("button", { id: "end", hidden: true, onclick: () => this.pool.end() }, "End it");
    this.told = make("p", { id: "told", className: "quiet" }, "By the simulator, in this browser.");
    this.canvas = make("canvas", { id: "areas", hidden: true });
    this.files = make("p", { id: "files" });
    const { sweep, grid, hit, design } = this.buttons;
    this.panel = make("fieldset", { id: "studies" }, make("legend", {}, "Simulator"),
      make("div", { className: "row" }, sweep, grid), make("div", { className: "row" }, hit, design),
      this.told, this.canvas, this.files, this.end);
  }

  // Clears the results for another device.
  take(scene) {
    if (this.busy) this.pool.end();
    this.scene = scene;
    this.show("By the simulator, in this browser.");
  }

  show(text, files = {}) {
    this.told.textContent = text;
    this.canvas.hidden = true;
    this.files.replaceChildren(...Object.entries(files).flatMap(([name, bytes]) => [
      this.make("button", { onclick: () => give(name, "application/octet-stream", bytes) }, name), " "]));
  }

  async run(name) {
    if (this.busy || !this.scene) return null;
    this.busy = true;
    for (const button of Object.values(this.buttons)) button.disabled = true;
    this.end.hidden = false;
    this.show("working …");
    const begun = performance.now();
    try {
      const found = await this[name]((done, all) => { this.told.textContent = `${done} of ${all} …`; });
      found.seconds = (performance.now() - begun) / 1000;
      this.show(`${found.text} ${found.seconds.toFixed(1)} s.`, found.files);
      if (found.areas) this.draw(found.areas);
      return found;
    } catch (error) {
      this.show(error.message);
      return { error: error.message };
    } finally {
      this.busy = false;
      this.end.hidden = true;
      for (const button of Object.values(this.buttons)) button.disabled = false;
    }
  }

  // As `cargo sim sweep SCENE --repeat 1 --plain`.
  async sweep(done) {
    const scene = this.scene;
    const { cutoffs_hz: cutoffs } = await this.pool.ask({ ask: "cutoffs", ...scene });
    // Two cutoffs per question, since two walks run in parallel. Slow cutoffs are neighbours, so each question gets
    // distant ones.
    const parts = Math.ceil(cutoffs.length / 2);
    const dealt = Array.from({ length: parts }, (_, n) => cutoffs.filter((_, m) => m % parts === n));
    const answers = await this.pool.all(dealt.map((cutoffs_hz) => ({ ask: "walk", ...scene, cutoffs_hz, repeat: 1 })), done);
    const walked = answers.flatMap((answer) => answer.walked);
    const found = await this.pool.ask({ ask: "sweep", ...scene, walked, repeat: 1 });
    const [boundary, areas] = found.bytes;
    const [, ...rows] = new TextDecoder().decode(areas).trim().split("\n").map((row) => row.split(",").map(Number));
    const ideal = found.ideal_cutoff_hz;
    const text = ideal === null ? "No stable wall at any cutoff." : `Ideal cutoff ${ideal} Hz, range ${found.ideal_cutoff_range_hz.join(" to ")} Hz.`;
    return { text: [text, ...found.notes].join(" "), files: { "boundary.csv": boundary, "areas.csv": areas }, areas: { rows, ideal } };
  }

  // As `cargo sim grid --csv`, over the page's plane.
  async grid(done) {
    const { plane } = window.zwidth;
    const { at } = await this.inForce([]);
    const [bEnd, kEnd] = plane.ends;
    const steps = (end) => Array.from({ length: GRID }, (_, n) => +(end * (n + 1) / GRID).toPrecision(6));
    const [dampings, stiffnesses] = [steps(bEnd), steps(kEnd)];
    const questions = dampings.map((b) => ({ ask: "grid", ...this.scene, ...at.list, stiffnesses, dampings: [b] }));
    const answers = await this.pool.all(questions, done);
    const tables = answers.map(({ bytes }) => new TextDecoder().decode(bytes[0]).split("\n"));
    const rows = tables.flatMap(([, ...rows]) => rows.filter(Boolean));
    plane.hits = rows.map((row) => row.split(",")).map(([, b, k, verdict]) => [+b, +k, verdict === "stable"]);
    plane.draw();
    const stable = answers.reduce((sum, answer) => sum + answer.stable, 0);
    return { text: `${stable} of ${rows.length} walls are stable${at.said}.`, files: { "grid.csv": [tables[0][0], ...rows, ""].join("\n") } };
  }

  // The present wall, as `cargo board hit --telemetry` and `cargo sim hit --trace` run it.
  async hit() {
    const { at, settings: { k, b } } = await this.inForce(["wall"]);
    const question = { ...this.scene, ...at.one, k, b };
    const [board, simulated] = await Promise.all([
      this.pool.ask({ ask: "board hit", ...question, board: BOARD }, null, [await this.link.image]),
      this.pool.ask({ ask: "hit", ...question }),
    ]);
    const said = ({ verdict, rms_m }) => `${verdict}, RMS ${(rms_m * 1e6).toPrecision(3)} µm`;
    return { board, simulated, text: `Board: ${said(board)}. Simulator: ${said(simulated)}.`,
      files: { "capture.bin": board.bytes[0], "hit.csv": simulated.bytes[0] } };
  }

  // As `cargo sim design --budget 100`, in a single worker.
  async design() {
    const found = await this.pool.ask({ ask: "design", ...this.scene, budget: BUDGET });
    return { text: found.text, files: { "design.csv": found.bytes[0], "best.toml": found.bytes[1] } };
  }

  // The settings in force, and their cutoff for the simulator. A study is about the scene. So it is refused if the
  // board's estimator or one of the settings `names` differs from the scene's.
  async inForce(names) {
    const text = window.zwidth.state?.settings;
    if (!text) throw new Error("The board has not told its settings yet.");
    const settings = told(text);
    const { wanted, has_cutoff } = await this.pool.ask({ ask: "scene", ...this.scene });
    const isOther = ([name, value]) => name === "estimator" ? settings.estimator !== value : !isSame(settings[name], value);
    const all = Object.entries(wanted).filter(([name]) => ["estimator", ...TUNINGS, ...names].includes(name));
    const others = all.filter(isOther);
    if (others.length) {
      const said = (pairs) => pairs.map(([name, value]) => `${name} ${value}`).join(", ");
      const has = others.filter(([name]) => settings[name] !== undefined).map(([name]) => [name, settings[name]]);
      throw new Error(`This is of the scene, ${said(others)}; the board has ${said(has)}. Give it the scene's.`);
    }
    if (!has_cutoff) return { settings, at: { one: {}, list: {}, said: "" } };
    const value = settings.tuning;
    return { settings, at: { one: { cutoff_hz: value }, list: { cutoffs_hz: [value] }, said: ` at ${value} Hz` } };
  }

  draw({ rows, ideal }) {
    this.canvas.hidden = false;
    const { drawing: d, width, height, style } = context(this.canvas);
    const [left, bottom] = [6, 16];
    const [first, last] = [rows[0][0], rows.at(-1)[0]];
    const most = Math.max(...rows.map((row) => row[2]), 1e-300);
    const x = (hz) => left + (last > first ? Math.log(hz / first) / Math.log(last / first) : .5) * (width - 2 * left);
    const y = (area) => height - bottom - area / most * (height - bottom - 8);
    d.strokeStyle = style("--line");
    d.beginPath(); d.moveTo(0, y(0)); d.lineTo(width, y(0)); d.stroke();
    d.strokeStyle = d.fillStyle = style("--blue");
    d.lineWidth = 1.75;
    d.beginPath();
    for (const [hz, , area] of rows) d.lineTo(x(hz), y(area));
    d.stroke();
    for (const [hz, , area] of rows) { d.beginPath(); d.arc(x(hz), y(area), hz === ideal ? 4.5 : 2, 0, 7); d.fill(); }
    d.font = "10.5px system-ui";
    d.fillStyle = style("--quiet");
    d.textAlign = "left"; d.fillText(`${first} Hz`, 0, height - 3);
    d.textAlign = "right"; d.fillText(`${last} Hz`, width, height - 3);
    d.textAlign = "center"; d.fillText("area over cutoff", width / 2, height - 3);
  }
}
