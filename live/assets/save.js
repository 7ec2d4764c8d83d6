// Saves figures as SVG, and the view as CSV.
import { SIGNALS } from "./plots.js";

export function give(name, kind, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: kind }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const INK = ["#0b61a4", "#1d7a3e", "#b4540a"];

function panel(title, top, wide, tall, points, colour) {
  const finite = points.filter(([x, y]) => Number.isFinite(x) && Number.isFinite(y));
  if (!finite.length) return "";
  const ends = (n) => finite.reduce(([low, high], point) => [Math.min(low, point[n]), Math.max(high, point[n])], [Infinity, -Infinity]);
  const [x0, x1] = ends(0), [y0, y1] = ends(1);
  const x = (value) => 70 + (value - x0) / (x1 - x0 || 1) * (wide - 90);
  const y = (value) => top + tall - 24 - (value - y0) / (y1 - y0 || 1) * (tall - 40);
  const path = finite.map(([a, b]) => `${x(a).toFixed(2)},${y(b).toFixed(2)}`).join(" ");
  return `<text x="70" y="${top + 11}">${title}</text><rect x="70" y="${top + 16}" width="${wide - 90}" height="${tall - 40}" fill="none" stroke="#bbb"/>` +
    `<polyline points="${path}" fill="none" stroke="${colour}"/>` +
    `<text x="66" y="${top + 24}" text-anchor="end">${+y1.toPrecision(4)}</text><text x="66" y="${top + tall - 24}" text-anchor="end">${+y0.toPrecision(4)}</text>` +
    `<text x="70" y="${top + tall - 10}">${+x0.toPrecision(8)}</text><text x="${wide - 20}" y="${top + tall - 10}" text-anchor="end">${+x1.toPrecision(8)}</text>`;
}

export function saveFigures(plots, plane, caption) {
  const seen = plots.seen;
  if (!seen) return;
  const curve = (n, factor) => Array.from({ length: 2 * seen.count }, (_, k) => [seen.start + (k >> 1) * seen.bin, seen.ends[n][k % 2][k >> 1] * factor]);
  const signal = ({ name }, n) => panel(`${plots.label(name)}, over s`, 24 + 170 * n, 900, 170, curve(n, plots.units[name].times), INK[n]);
  const { k, b } = plane.units;
  const parts = [...SIGNALS.map(signal),
    panel(`predicted boundary: K, ${k.unit}, over B, ${b.unit}`, 534, 450, 220, plane.predicted?.points ?? [], "#0b61a4"),
  ];
  if (plane.walk.length > 1) parts.push(`<g transform="translate(450 0)">${panel("the board's walk", 534, 450, 220, plane.walk, "#6b3fa0")}</g>`);
  const text = caption.replace(/[&<>]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[sign]);
  give("zwidth.svg", "image/svg+xml", `<svg xmlns="http://www.w3.org/2000/svg" width="900" height="760" font-family="sans-serif" font-size="11"><rect width="900" height="760" fill="#fff"/><text x="10" y="15">${text}</text>${parts.join("")}</svg>`);
}

export async function saveRows(plots, link) {
  const seen = plots.seen;
  if (!seen) return "nothing to save";
  const rows = Math.min(seen.count * seen.stride, 200000);
  try {
    give("zwidth.csv", "text/csv", await link.rows(seen.first, rows));
    return "";
  } catch (error) {
    return error.message;
  }
}
