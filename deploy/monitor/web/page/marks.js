// Colours, canvases, even numbers for axes, elements, and the marks of sensors and UAVs.

export const UAV = 11; // half the size of a UAV's mark, pixels
export const LINK = { colour: "#222", dash: [2, 3] };
export const DOWN_DASH = [7, 4]; // of links out of range
export const HOP_DASH = [9, 3, 2, 3]; // of hops between relays and to the base station

export function rgb(colour) {
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
}

// 256 colours between evenly spaced stops, as [r, g, b].
export function ramp(stops) {
  const known = stops.map(rgb);
  return Array.from({ length: 256 }, (_, level) => {
    const place = (level / 255) * (known.length - 1);
    const low = Math.min(Math.floor(place), known.length - 2);
    return known[low].map((value, c) => Math.round(value + (known[low + 1][c] - value) * (place - low)));
  });
}

export function css([r, g, b], alpha = 1) {
  return `rgba(${r},${g},${b},${alpha})`;
}

// A canvas in device pixels, drawn on in CSS pixels.
export function prepare(canvas) {
  const { width, height } = canvas.getBoundingClientRect();
  const ratio = window.devicePixelRatio || 1;
  const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

// Matplotlib's marks by their letters, as paths around a place.
const CORNERS = {
  s: [[-1, -1], [1, -1], [1, 1], [-1, 1]],
  "^": [[0, -1.2], [1.2, 1], [-1.2, 1]],
  v: [[0, 1.2], [1.2, -1], [-1.2, -1]],
  D: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]],
  P: [[-0.42, -1.15], [0.42, -1.15], [0.42, -0.42], [1.15, -0.42], [1.15, 0.42], [0.42, 0.42], [0.42, 1.15],
    [-0.42, 1.15], [-0.42, 0.42], [-1.15, 0.42], [-1.15, -0.42], [-0.42, -0.42]],
  X: [[-1, -0.4], [-0.4, -1], [0, -0.5], [0.4, -1], [1, -0.4], [0.5, 0], [1, 0.4], [0.4, 1], [0, 0.5], [-0.4, 1],
    [-1, 0.4], [-0.5, 0]],
  p: Array.from({ length: 5 }, (_, k) => [1.2 * Math.sin(0.4 * Math.PI * k), -1.2 * Math.cos(0.4 * Math.PI * k)]),
  "*": Array.from({ length: 10 }, (_, k) => {
    const [angle, size] = [(k * Math.PI) / 5, k % 2 ? 0.55 : 1.35];
    return [Math.sin(angle) * size, -Math.cos(angle) * size];
  }),
};

export function mark(pen, kind, x, y, size) {
  pen.beginPath();
  if (!CORNERS[kind]) pen.arc(x, y, size, 0, 2 * Math.PI);
  else for (const [dx, dy] of CORNERS[kind]) pen.lineTo(x + dx * size, y + dy * size);
  pen.closePath();
}

export const UAV_MARKS = { communication: "P", monitoring: "s", collection: "^" };

// A UAV's mark with an arrowhead towards where it flies; the number stands in it.
export function uav(pen, type, x, y, size, number, heading) {
  pen.lineJoin = "round";
  if (heading) {
    const [hx, hy] = heading;
    const [near, far, half] = [size * 1.35, size * 2.25, size * 0.62];
    pen.beginPath();
    pen.moveTo(x + hx * far, y + hy * far);
    pen.lineTo(x + hx * near - hy * half, y + hy * near + hx * half);
    pen.lineTo(x + hx * near + hy * half, y + hy * near - hx * half);
    pen.closePath();
    pen.lineWidth = 2.5;
    pen.strokeStyle = "#fff";
    pen.stroke();
    pen.fillStyle = type.colour;
    pen.fill();
  }
  const wide = type.name === "communication" ? size * 1.12 : size;
  mark(pen, UAV_MARKS[type.name], x, y, wide);
  pen.lineWidth = 3;
  pen.strokeStyle = "#fff";
  pen.stroke();
  pen.fillStyle = type.colour;
  pen.fill();
  if (number === null) return;
  pen.fillStyle = "#fff";
  pen.font = `600 ${size * 1.05}px system-ui, sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(number, x, y + (type.name === "collection" ? size * 0.28 : 0.5));
}

export function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough * 0.999);
}

export function by(id) {
  return document.getElementById(id);
}

// A colour of the present theme.
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export function number(value, digits) {
  return value.toFixed(digits).replace("-", "\u2212");
}

export function icon(draw) {
  const canvas = document.createElement("canvas");
  canvas.className = "icon";
  queueMicrotask(() => draw(prepare(canvas).pen));
  return canvas;
}

export function item(sign, text) {
  const line = document.createElement("li");
  line.append(sign, text);
  return line;
}

export function swatch(fill) {
  const box = document.createElement("span");
  box.className = "swatch";
  box.style.background = fill;
  return box;
}
