// The device: a handle, the wall, and a finger that pulls through a spring. Values are in m and N at the handle. The
// drawing shows the device's whole travel.
import { context, roundUp } from "./plots.js";
import { Units } from "./units.js";

// Length of the arrow of the full force, pixels.
const ARROW = 83;

export class Handle {
  constructor(canvas, send) {
    Object.assign(this, { canvas, send, units: new Units(), fullScale: 1, finger: null, held: false, allowed: false, low: 0, high: 1 });
    canvas.onpointerdown = (event) => {
      if (!this.allowed) return;
      canvas.setPointerCapture(event.pointerId);
      this.held = true;
      canvas.classList.add("held");
      this.pull(event);
    };
    canvas.onpointermove = (event) => { if (this.held) this.pull(event); };
    const release = () => {
      if (!this.held) return;
      this.held = false;
      this.finger = null;
      canvas.classList.remove("held");
      this.send({ type: "finger", target_m: null });
    };
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, release);
    window.addEventListener("blur", release);
    this.release = release;
  }

  pull(event) {
    const { left, width } = this.canvas.getBoundingClientRect();
    const place = this.low + (event.clientX - left) / width * (this.high - this.low);
    this.finger = Math.min(Math.max(place, this.low), this.high);
    const now = performance.now();
    if (now - (this.sent ?? 0) < 8) return;
    this.sent = now;
    this.send({ type: "finger", target_m: this.finger });
  }

  draw({ position, wall, force, finger, on, contact }) {
    const { drawing: d, width, height, style } = context(this.canvas);
    const x = (metres) => (metres - this.low) / (this.high - this.low) * width;
    const middle = height * .47;
    d.font = "10.5px system-ui";
    // the scale
    d.strokeStyle = style("--line"); d.fillStyle = style("--quiet"); d.textAlign = "center";
    d.beginPath(); d.moveTo(0, height - 18.5); d.lineTo(width, height - 18.5); d.stroke();
    const { times } = this.units.position;
    const step = roundUp((this.high - this.low) * times / 16, [1, 2, 5, 10]);
    for (let n = Math.ceil(this.low * times / step); n * step <= this.high * times; n++) {
      const at = x(n * step / times);
      d.beginPath(); d.moveTo(at, height - 18); d.lineTo(at, height - 13); d.stroke();
      if (at > 12 && at < width - 12) d.fillText(+(n * step).toPrecision(3), at, height - 3);
    }
    // the wall: solid while the force is on
    const surface = x(wall);
    d.save(); d.beginPath(); d.rect(surface, 0, width - surface, height - 19); d.clip();
    d.globalAlpha = on ? .9 : .3; d.fillStyle = contact && on ? style("--contact") : style("--grid");
    d.fillRect(surface, 0, width - surface, height);
    d.strokeStyle = style("--quiet"); d.lineWidth = 1;
    for (let k = surface - height; k < width; k += 9) { d.beginPath(); d.moveTo(k, height); d.lineTo(k + height, 0); d.stroke(); }
    d.restore();
    d.strokeStyle = style("--text"); d.lineWidth = on ? 3 : 1; d.beginPath(); d.moveTo(surface, 0); d.lineTo(surface, height - 19); d.stroke();
    // rail, finger, handle
    d.lineWidth = 2; d.strokeStyle = style("--line"); d.beginPath(); d.moveTo(0, middle); d.lineTo(width, middle); d.stroke();
    const at = x(position);
    if (this.held && this.finger !== null) {
      const to = x(this.finger), turns = 14;
      d.strokeStyle = style("--violet"); d.lineWidth = 1.5; d.beginPath(); d.moveTo(at, middle);
      for (let k = 1; k < turns; k++) d.lineTo(at + (to - at) * k / turns, middle + (k % 2 ? -6 : 6));
      d.lineTo(to, middle); d.stroke();
      d.fillStyle = style("--violet"); d.beginPath(); d.arc(to, middle, 5, 0, 7); d.fill();
    }
    d.fillStyle = contact && on ? style("--orange") : style("--blue");
    d.beginPath(); d.roundRect(at - 11, middle - 24, 11, 48, 3); d.fill();
    // the force on the handle
    const part = force / this.fullScale;
    if (Math.abs(part) > .0034) {
      d.strokeStyle = d.fillStyle = style("--orange"); d.lineWidth = 3;
      const from = at - 5, end = from + part * ARROW, up = middle - 29;
      d.beginPath(); d.moveTo(from, up); d.lineTo(end, up); d.stroke();
      d.beginPath(); d.moveTo(end + Math.sign(end - from) * 7, up); d.lineTo(end, up - 4); d.lineTo(end, up + 4); d.fill();
    }
    d.fillStyle = style("--text"); d.textAlign = "left"; d.font = "12px system-ui";
    const digits = 2 - Math.min(0, Math.floor(Math.log10(this.fullScale * this.units.force.times)));
    const newtons = (value) => this.units.say("force", value, (said) => said.toFixed(digits));
    const texts = [this.units.say("position", position, (said) => said.toFixed(3)), `actuator ${newtons(force)}`];
    if (finger !== undefined) texts.push(`finger ${newtons(finger)}`);
    const wide = this.units.rotary ? [110, 150, 140] : [88, 112, 98];
    let left = 8;
    texts.forEach((text, n) => { d.fillText(text, left, 15); left += wide[n]; });
    if (this.allowed && !this.held) { d.fillStyle = style("--quiet"); d.fillText("drag the handle", left, 15); }
  }
}
