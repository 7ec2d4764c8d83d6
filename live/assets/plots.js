// Curves over time, spectrum and phase plane.
import { Units } from "./units.js";

// `least`: smallest margin of a curve's axis above and below the curve, in units at the handle.
export const SIGNALS = [
  { name: "position", least: 2e-6, colour: "--blue" },
  { name: "velocity", least: 1e-3, colour: "--green" },
  { name: "force", least: 1e-3, colour: "--orange" },
];
const CONTACT = 1, SATURATED = 4, ON = 8;
const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function context(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const drawing = canvas.getContext("2d");
  drawing.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawing.clearRect(0, 0, width, height);
  return { drawing, width, height, style };
}

// Contents of a message with curves.
export function curves(bytes, rate) {
  const head = new DataView(bytes);
  const count = head.getUint32(4, true);
  const [first, stride, step] = [8, 16, 24].map((place) => head.getFloat64(place, true));
  const array = (n) => new Float32Array(bytes, 32 + 4 * count * n, count);
  return { count, first, stride, step, start: first * step / rate, bin: stride * step / rate,
    ends: [0, 1, 2].map((n) => [array(2 * n), array(2 * n + 1)]), flags: array(6) };
}

export class Plots {
  constructor(parent, spectrum, phase) {
    this.phaseCanvas = phase;
    this.spectrumParent = spectrum;
    this.parents = SIGNALS.map(() => parent.appendChild(document.createElement("div")));
    this.rate = 10000;
    this.units = new Units();
    this.make();
    new ResizeObserver(() => this.resize()).observe(parent);
    new ResizeObserver(() => this.resize()).observe(spectrum);
  }

  make() {
    for (const plot of this.plots ?? []) plot.destroy();
    this.spectrum?.destroy();
    const axis = (more) => ({ stroke: style("--quiet"), font: "11px system-ui", ticks: { stroke: style("--line"), size: 4 },
      grid: { stroke: style("--grid"), width: 1 }, ...more });
    const sync = uPlot.sync("time");
    this.plots = SIGNALS.map((signal, n) => {
      const last = n === SIGNALS.length - 1;
      return new uPlot({
        width: 400, height: 120, legend: { show: false }, padding: [8, 12, last ? 0 : 4, 0], pxAlign: 0,
        cursor: { sync: { key: sync.key }, drag: { x: false, y: false }, points: { size: 5 } },
        scales: { x: { time: false }, y: { range: (_, low, high) => {
          if (low == null) return [-1, 1];
          const room = Math.max((high - low) * .08, signal.least * this.units[signal.name].times);
          return [low - room, high + room];
        } } },
        series: [{}, { stroke: style(signal.colour), width: 1.25, points: { show: false }, spanGaps: false }],
        axes: [axis({ show: true, size: last ? 26 : 8, values: last ? (_, all) => all.map((t) => `${+t.toFixed(4)} s`) : () => [] }),
          axis({ size: 58, values: (_, all) => all.map((value) => +value.toPrecision(6)), label: this.label(signal.name), labelSize: 14, labelFont: "11px system-ui", labelGap: 0, space: 24 })],
        hooks: { drawClear: [(plot) => this.shade(plot, n)] },
      }, [[0], [null]], this.parents[n]);
    });
    this.spectrum = new uPlot({
      width: 300, height: 150, legend: { show: false }, padding: [6, 10, 0, 0], cursor: { drag: { x: false, y: false } },
      scales: { x: { time: false, distr: 3 }, v: { distr: 3 }, f: { distr: 3 } },
      series: [{}, { scale: "v", stroke: style("--green"), width: 1.25, points: { show: false } },
        { scale: "f", stroke: style("--orange"), width: 1.25, points: { show: false } }],
      axes: [axis({ size: 26, values: (_, all) => all.map((f) => f == null ? "" : f >= 1000 ? `${f / 1000} k` : `${f} Hz`) }),
        axis({ scale: "v", size: 54, label: this.label("velocity"), labelSize: 14, labelFont: "11px system-ui", values: powers }),
        axis({ scale: "f", side: 1, size: 54, grid: { show: false }, label: this.label("force"), labelSize: 14, labelFont: "11px system-ui", values: powers })],
    }, [[1, 10], [1, 1], [1, 1]], this.spectrumParent);
    this.resize();
  }

  resize() {
    this.plots.forEach((plot, n) => plot.setSize({ width: this.parents[n].clientWidth, height: this.parents[n].clientHeight }));
    const { clientWidth, clientHeight } = this.spectrumParent;
    this.spectrum.setSize({ width: clientWidth - 12, height: Math.max(clientHeight - 8, 80) });
  }

  label(name) { return `${name}, ${this.units[name].unit}`; }

  columns() { return Math.max(200, Math.min(2000, this.parents[0].clientWidth - 80)); }

  // Shows contact behind the curves, and a line under the force where the actuator was saturated.
  shade(plot, n) {
    const seen = this.seen;
    if (!seen) return;
    const { ctx, bbox: { left, top, width, height } } = plot;
    ctx.save();
    ctx.beginPath(); ctx.rect(left, top, width, height); ctx.clip();
    const runs = (flag, colour, y, tall) => {
      ctx.fillStyle = colour;
      for (let k = 0; k < seen.count; k++) {
        const is = (place) => (seen.flags[place] & flag) === flag;
        if (!is(k)) continue;
        let end = k;
        while (end < seen.count && is(end)) end++;
        const [a, b] = [k, end].map((place) => plot.valToPos(seen.start + place * seen.bin, "x", true));
        ctx.fillRect(a, y, Math.max(b - a, 1), tall);
        k = end;
      }
    };
    runs(CONTACT, style("--contact"), top, height);
    if (n === 2) runs(SATURATED | ON, style("--red"), top + height - 3, 3);
    ctx.restore();
  }

  draw(bytes) {
    const seen = this.seen = curves(bytes, this.rate);
    const times = new Array(2 * seen.count);
    for (let k = 0; k < seen.count; k++) times[2 * k] = times[2 * k + 1] = seen.start + k * seen.bin;
    this.plots.forEach((plot, n) => {
      const [low, high] = seen.ends[n];
      const values = new Array(2 * seen.count);
      const { times: factor } = this.units[SIGNALS[n].name];
      let turn = 0;
      for (let k = 0; k < seen.count; k++) {
        const a = low[k] * factor, b = high[k] * factor;
        // The extreme that is nearer to the last point comes first, so that a smooth curve stays smooth.
        const up = k === 0 || Number.isNaN(turn) || Math.abs(a - turn) <= Math.abs(b - turn);
        values[2 * k] = Number.isNaN(a) ? null : up ? a : b;
        values[2 * k + 1] = Number.isNaN(a) ? null : up ? b : a;
        turn = up ? b : a;
      }
      plot.setData([times, values]);
    });
  }

  drawSpectra(bytes) {
    const head = new Uint32Array(bytes, 0, 4), all = new Float32Array(bytes, 16);
    const [, nv, nf] = head;
    const list = (name, from, n) => Array.from({ length: n }, (_, k) => {
      const [hertz, amplitude] = all.subarray(2 * (from + k));
      return [hertz, Math.max(amplitude * this.units[name].times, 1e-12)];
    });
    const [velocity, force] = [list("velocity", 0, nv), list("force", nv, nf)];
    const tables = [velocity, force].map((points) => [points.map((p) => p[0]), points.map((p) => p[1])]);
    this.spectrum.setData(uPlot.join(tables));
  }

  drawPhase(bytes) {
    const count = new DataView(bytes).getUint32(4, true);
    const [x, v] = [0, 1].map((n) => new Float32Array(bytes, 8 + 4 * count * n, count));
    const { drawing, width, height } = context(this.phaseCanvas);
    const ends = (values) => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
    const [[x0, x1], [v0, v1]] = [ends(x), ends(v)];
    if (!(x1 >= x0)) return;
    const middle = (a, b, least) => { const half = Math.max((b - a) * .55, least); return [(a + b) / 2 - half, (a + b) / 2 + half]; };
    const [xa, xb] = middle(x0, x1, 5e-6), [va, vb] = middle(v0, v1, 1e-3);
    const [left, bottom] = [46, 16];
    const px = (value) => left + (value - xa) / (xb - xa) * (width - left - 8);
    const py = (value) => height - bottom - (value - va) / (vb - va) * (height - bottom - 6);
    drawing.font = "10.5px system-ui"; drawing.fillStyle = style("--quiet"); drawing.strokeStyle = style("--grid");
    drawing.beginPath(); drawing.moveTo(left, py(0)); drawing.lineTo(width - 8, py(0)); drawing.stroke();
    drawing.strokeStyle = style("--line"); drawing.strokeRect(left, 6, width - left - 8, height - bottom - 6);
    drawing.textAlign = "right";
    const { position, velocity } = this.units;
    for (const value of [va, vb]) drawing.fillText(short(value * velocity.times), left - 4, Math.min(Math.max(py(value) + 4, 14), height - bottom));
    drawing.textAlign = "left"; drawing.fillText((xa * position.times).toFixed(3), left, height - 4);
    drawing.textAlign = "right"; drawing.fillText((xb * position.times).toFixed(3), width - 8, height - 4);
    drawing.strokeStyle = style("--violet"); drawing.lineWidth = 1.1; drawing.beginPath();
    for (let k = 0; k < count; k++) drawing.lineTo(px(x[k]), py(v[k]));
    drawing.stroke();
    drawing.fillStyle = style("--text"); drawing.beginPath(); drawing.arc(px(x[count - 1]), py(v[count - 1]), 3, 0, 7); drawing.fill();
  }
}

// The next larger round number.
export function roundUp(value, rounds = [1, 1.5, 2, 3, 4, 5, 6, 8, 10]) {
  const power = 10 ** Math.floor(Math.log10(value));
  return rounds.map((n) => n * power).find((round) => round >= value);
}

// Two significant digits, or all digits before the decimal point.
function short(value) { return Math.abs(value) < 100 ? value.toPrecision(2) : value.toFixed(0); }

function powers(_, all) { return all.map((value) => value == null ? "" : Math.log10(value) % 1 ? "" : value.toExponential(0)); }
