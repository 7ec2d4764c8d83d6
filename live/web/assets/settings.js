// What a board's `get` says of estimator and wall, and how another board comes to the same.
const PLACES = 8; // parameters of an estimator
const TIME = 10000; // ms that a board has to take settings over

export const WALL = ["wall", "push", "k", "b"];
export const TUNINGS = Array.from({ length: PLACES }, (_, place) => `tuning${place ? place + 1 : ""}`);

// To what a board shows of a number, and scenes are converted to.
export const isSame = (one, other) => one === other || Math.abs(one - other) <= 1e-9 * Math.max(Math.abs(one), Math.abs(other));

// `ok get k 0 N/m, b 0 N s/m, wall 0.07 m, cutoff 1500 Hz, quality 0.5 1, estimator biquad, push 0 N, ..`: the estimator's
// parameters stand between wall and estimator. By the commands that set them.
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

// Settings that the next board is to have. They go there as commands once it has told its own, with the force off, so that it
// takes walls of any size, and `get` behind them; what depends on another one is taken in another round. What it does not
// take is said.
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
