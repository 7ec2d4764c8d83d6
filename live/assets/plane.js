// The (K, B) plane: the image's envelope, the simulator's boundaries by the scene's criterion and (dashed) of quiet
// walls, the board's own walk, and the wall in force; all in the console's units.
import { context, roundUp } from "./plots.js";
import { Units } from "./units.js";

const LEFT = 40, BOTTOM = 20, TOP = 6, RIGHT = 8;

export class Plane {
  constructor(canvas, want) {
    Object.assign(this, { canvas, want, units: new Units(), predicted: null, wall: null, walk: [], hits: [], drag: null, allowed: false, ends: [100, 40000] });
    canvas.onpointerdown = (event) => {
      if (!this.allowed) return;
      canvas.setPointerCapture(event.pointerId);
      this.move(event);
    };
    canvas.onpointermove = (event) => { if (this.drag) this.move(event); };
    canvas.onpointerup = () => {
      if (!this.drag) return;
      this.want(this.drag, true);
      this.drag = null;
      this.draw();
    };
    canvas.onpointercancel = () => { this.drag = null; this.draw(); };
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  move(event) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const [bEnd, kEnd] = this.ends;
    const b = (event.clientX - left - LEFT) / (width - LEFT - RIGHT) * bEnd;
    const k = (top + height - BOTTOM - event.clientY) / (height - TOP - BOTTOM) * kEnd;
    const whole = (value, step, end) => Math.min(Math.max(Math.round(value / step) * step, 0), end);
    this.drag = { b: whole(b, bEnd / 200, bEnd), k: whole(k, kEnd / 200, kEnd) };
    this.want(this.drag, false);
    this.draw();
  }

  // The axes cover all predictions, and end at round numbers.
  fit() {
    const all = [...(this.predicted?.points ?? []), ...(this.predicted?.envelope ?? []).map(([b, , k]) => [b, k]), ...this.walk, ...this.hits];
    if (this.wall) all.push([this.wall.b, this.wall.k]);
    const end = (n, least) => roundUp(Math.max(least, ...all.map((point) => point[n] * 1.08)));
    this.ends = [end(0, 20 * this.units.b.times), end(1, 2000 * this.units.k.times)];
  }

  draw() {
    const { drawing: d, width, height, style } = context(this.canvas);
    if (width < 50) return;
    if (!this.drag) this.fit();
    const [bEnd, kEnd] = this.ends;
    const x = (b) => LEFT + b / bEnd * (width - LEFT - RIGHT);
    const y = (k) => height - BOTTOM - k / kEnd * (height - TOP - BOTTOM);
    d.font = "10.5px system-ui"; d.lineWidth = 1;
    for (let n = 0; n <= 4; n++) {
      const [b, k] = [bEnd * n / 4, kEnd * n / 4];
      d.strokeStyle = style("--grid");
      d.beginPath(); d.moveTo(x(b), TOP); d.lineTo(x(b), y(0)); d.moveTo(LEFT, y(k)); d.lineTo(width - RIGHT, y(k)); d.stroke();
      d.fillStyle = style("--quiet");
      d.textAlign = n === 4 ? "right" : "center"; d.fillText(+b.toPrecision(4), x(b), height - 6);
      d.textAlign = "right"; d.fillText(+(k * this.units.axis.times).toPrecision(3), LEFT - 5, y(k) + 4);
    }
    const envelope = this.predicted?.envelope ?? [];
    if (envelope.length) {
      d.fillStyle = style("--green"); d.globalAlpha = .16; d.beginPath();
      d.moveTo(x(0), y(envelope[0][2]));
      envelope.forEach(([b, , high]) => d.lineTo(x(b), y(high)));
      [...envelope].reverse().forEach(([b, low]) => d.lineTo(x(b), y(low)));
      d.lineTo(x(0), y(envelope[0][1])); d.fill(); d.globalAlpha = 1;
    }
    const line = (points, colour, wide, dash = []) => {
      d.strokeStyle = colour; d.lineWidth = wide; d.setLineDash(dash); d.beginPath();
      points.forEach(([b, k]) => d.lineTo(x(b), y(k)));
      d.stroke(); d.setLineDash([]);
    };
    line(this.predicted?.points ?? [], style("--blue"), 1.75);
    line(this.predicted?.quiet ?? [], style("--blue"), 1.75, [5, 4]);
    for (const [b, k, stable] of this.hits) {
      d.fillStyle = stable ? style("--green") : style("--red");
      d.fillRect(x(b) - 1.5, y(k) - 1.5, 3, 3);
    }
    line(this.walk, style("--violet"), 1.75);
    for (const [b, k] of this.walk) { d.fillStyle = style("--violet"); d.beginPath(); d.arc(x(b), y(k), 3, 0, 7); d.fill(); }
    if (this.wall) this.point(d, x(this.wall.b), y(this.wall.k), style("--text"), true);
    if (this.drag) {
      this.point(d, x(this.drag.b), y(this.drag.k), style("--blue"), false);
      const right = this.drag.b > bEnd * .6;
      d.fillStyle = style("--text"); d.textAlign = right ? "right" : "left"; d.font = "12px system-ui";
      const { k, b } = this.units;
      const text = `K ${this.drag.k.toPrecision(4)} ${k.unit}, B ${this.drag.b.toPrecision(3)} ${b.unit}`;
      const long = d.measureText(text).width + 4;
      const at = right ? Math.max(x(this.drag.b) - 10, long) : Math.min(x(this.drag.b) + 10, width - long);
      d.fillText(text, at, Math.max(y(this.drag.k) - 8, 16));
    }
  }

  point(d, x, y, colour, full) {
    d.strokeStyle = d.fillStyle = colour; d.lineWidth = 2; d.beginPath(); d.arc(x, y, 6, 0, 7);
    if (full) d.fill(); else d.stroke();
  }

  // Clears everything of the previous device.
  clear() {
    Object.assign(this, { predicted: null, wall: null, walk: [], hits: [], drag: null });
    this.draw();
  }

  // Handles a line of the board's walk.
  hear(text) {
    const hit = this.units.hit.exec(text);
    if (hit) this.hits.push([+hit[2], +hit[1], hit[3] === "stable"]);
    const found = this.units.boundary.exec(text);
    if (found) this.walk.push([+found[2], +found[1]]);
    if (text === "ok walk") [this.walk, this.hits] = [[], []];
    if (hit || found) this.draw();
  }
}
