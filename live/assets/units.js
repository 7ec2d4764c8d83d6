// Units of the page. The server sends m and N at the handle. A board uses these too; for a rotary handle it uses rad
// and N m about the axis. A person reads angles in degrees.
const DEGREES = 180 / Math.PI;

export class Units {
  // Distance of the handle from its axis, m; 0: a linear handle.
  constructor(radius_m = 0) {
    const r = radius_m;
    this.rotary = r > 0;
    // A value at the handle times `times` is the displayed value, in `unit`.
    const quantity = (linear, times, rotary, power, more = 1) =>
      this.rotary ? { unit: rotary, times: r ** power * more } : { unit: linear, times };
    // Units for display.
    this.position = quantity("mm", 1e3, "deg", -1, DEGREES);
    this.velocity = quantity("m/s", 1, "deg/s", -1, DEGREES);
    this.slow = quantity("mm/s", 1e3, "deg/s", -1, DEGREES);
    this.area = quantity("10⁶ N²s/m²", 1e-6, "N²m²s/rad²", 4);
    // Units of the console.
    this.force = quantity("N", 1, "N m", 1);
    this.wall = quantity("m", 1, "rad", -1);
    this.k = quantity("N/m", 1, "N m/rad", 2);
    this.b = quantity("N s/m", 1, "N m s/rad", 2);
    // Unit of the plane's K axis, and the factor from the console's K to its labels.
    this.axis = this.rotary ? { unit: this.k.unit, times: 1 } : { unit: "kN/m", times: 1e-3 };
    const point = `k (\\S+) ${this.k.unit}, b (\\S+) ${this.b.unit}`;
    this.hit = new RegExp(`^walk hit \\d+: ${point}, (\\w+)`);
    this.boundary = new RegExp(`^walk boundary \\d+: ${point}`);
    this.settings = new RegExp(`^ok get ${point}, `);
  }

  // A value at the handle as text with its unit.
  say(name, atHandle, digits) {
    const { unit, times } = this[name];
    return `${digits(atHandle * times)} ${unit}`;
  }

  // A prediction with walls in the console's units.
  predicted(found) {
    const [k, b] = [this.k.times, this.b.times];
    const walls = (points) => (points ?? []).map((p) => [p[0] * b, p[1] * k]);
    return { ...found, points: walls(found.points), quiet: walls(found.quiet),
      envelope: found.envelope.map((p) => [p[0] * b, p[1] * k, p[2] * k]) };
  }
}
