// Reads estimator and wall from a board's `get` reply, and sends these settings to another board.
const PLACES = 8; // parameters of an estimator
const TIME = 10000; // ms: time limit for a board to take settings over

export const WALL = ["wall", "push", "k", "b"];
export const TUNINGS = Array.from({ length: PLACES }, (_, place) => `tuning${place ? place + 1 : ""}`);

// Compares values within the precision of a board's display and of a scene's conversion.
export const isSame = (one, other) => one === other || Math.abs(one - other) <= 1e-9 * Math.max(Math.abs(one), Math.abs(other));

// `ok get k 0 N/m, b 0 N s/m, wall 0.07 m, cutoff 1500 Hz, quality 0.5 1, estimator biquad, push 0 N, ..`: the
// estimator's parameters are between wall and estimator.
export function told(text) {
  const parts = text.replace(/^ok get /, "").split(", ").map((part) => part.split(" "));
  const end = parts.findIndex(([name]) => name === "estimator");
  const parameters = parts.slice(3, end);
  const number = (wanted) => Number(parts.find(([name]) => name === wanted)[1]);
  const settings = { estimator: parts[end][1] };
  parameters.forEach(([, value], place) => { settings[TUNINGS[place]] = Number(value); });
  for (const name of WALL) settings[name] = number(name);
  return settings;
}

// Settings for the next board. They are sent as commands after the board has sent its own, with the force off, so that
// walls of any size are accepted. `get` follows. Settings that depend on others are sent in further rounds. A message
// lists the settings that the board does not take.
export class Restored {
  constructor(link, say) {
    Object.assign(this, { link, say, wanted: null, left: null, until: 0 });
    link.on("state", (state) => this.hear(state));
  }

  want(settings) { Object.assign(this, { wanted: settings && Object.keys(settings).length ? settings : null, left: null }); }

  hear({ settings, lines }) {
    if (!this.wanted || !settings) return;
    if (!this.left) {
      this.until = performance.now() + TIME;
      return this.send(["estimator", ...TUNINGS, ...WALL].filter((name) => this.wanted[name] !== undefined));
    }
    const answer = lines.findLast(({ from, text }) => from === "board" && text.startsWith("ok get "));
    if (answer) {
      const has = told(answer.text);
      const left = this.left.filter((name) => name === "estimator" ? has[name] !== this.wanted[name] : !isSame(has[name], this.wanted[name]));
      if (left.length && left.length < this.left.length) return this.send(left);
      if (left.length) this.say(`not taken over: ${left.map((name) => `${name} ${this.wanted[name]}`).join(", ")}; the log says why`);
    }
    if (answer || performance.now() > this.until) this.wanted = null;
  }

  send(left) {
    this.left = left;
    for (const name of left) this.link.command(`${name} ${this.wanted[name]}`);
    this.link.command("get");
  }
}
