// The charts beside the map: a reward's parts as stacked bars, mean AoI and VDF as lines, colour scales.

import { css, niceStep, prepare, ramp } from "./marks.js";
import { Past } from "./past.js";

const BIN = 5; // steps
const NICE = [1, 1.5, 2, 3, 4, 5, 6, 8, 10]; // where an axis may end, times a power of ten
const LEFT = 44;
const RIGHT = 6;

export function frameOf(canvas, steps, low, high, ink, line, title) {
  const { pen, width, height } = prepare(canvas);
  const box = { pen, left: LEFT, right: width - RIGHT, top: 22, bottom: height - 15 };
  box.x = (step) => box.left + ((box.right - box.left) * step) / steps;
  box.y = (value) => box.bottom - ((box.bottom - box.top) * (value - low)) / (high - low);
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = ink;
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  pen.fillText(title, 0, 11);
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  pen.strokeStyle = line;
  pen.lineWidth = 1;
  for (const value of [low, 0, high].filter((v, i, all) => all.indexOf(v) === i)) {
    if (value !== 0 && Math.abs(box.y(value) - box.y(0)) < 9) continue;
    pen.fillText(String(+value.toPrecision(3)).replace("-", "\u2212"), box.left - 5, box.y(value));
    pen.beginPath();
    pen.moveTo(box.left, Math.round(box.y(value)) + 0.5);
    pen.lineTo(box.right, Math.round(box.y(value)) + 0.5);
    pen.stroke();
  }
  pen.textBaseline = "top";
  for (const [step, align] of [[0, "left"], [steps / 2, "center"], [steps, "right"]]) {
    pen.textAlign = align;
    pen.fillText(step === steps ? `step ${step}` : Math.round(step), box.x(step), box.bottom + 3);
  }
  return box;
}

export class Charts {
  constructor(scene, parts, course) {
    this.scene = scene;
    this.course = course;
    parts.replaceChildren();
    this.canvases = scene.types.map((type) => {
      const canvas = document.createElement("canvas");
      canvas.className = "chart";
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `parts of the reward, ${type.label} UAVs`);
      return parts.appendChild(canvas);
    });
  }

  draw(past, number, ink, line, colours) {
    const begin = past.beginOf(number);
    this.scene.types.forEach((_, t) => this.drawParts(past, begin, number, t, ink, line));
    this.drawCourse(past, begin, number, ink, line, colours);
  }

  // Means of a type's parts in bins of steps: [[first step, [K]]...].
  bins(past, begin, number, t) {
    const K = this.scene.parts.length;
    const found = new Map();
    for (let n = begin; n <= number; n++) {
      const frame = past.at(n);
      if (frame.step === 0) continue; // nothing has been earned yet
      const bin = Math.floor((frame.step - 1) / BIN) * BIN;
      if (!found.has(bin)) found.set(bin, { sums: new Float64Array(K), count: 0 });
      const entry = found.get(bin);
      const row = Past.row(frame, "parts");
      for (let k = 0; k < K; k++) entry.sums[k] += row[t * K + k];
      entry.count += 1;
    }
    return [...found].map(([bin, { sums, count }]) => [bin, sums.map((sum) => sum / count)]);
  }

  drawParts(past, begin, number, t, ink, line) {
    const bins = this.bins(past, begin, number, t);
    const range = [0, 0];
    for (const [, means] of bins) {
      range[0] = Math.min(range[0], means.reduce((sum, v) => sum + Math.min(v, 0), 0));
      range[1] = Math.max(range[1], means.reduce((sum, v) => sum + Math.max(v, 0), 0));
    }
    const round = (v) => (v ? Math.sign(v) * NICE.map((m) => m * 10 ** Math.floor(Math.log10(Math.abs(v))))
      .find((most) => most >= Math.abs(v)) : 0);
    let [low, high] = range.map(round);
    if (high - low < 1e-9) [low, high] = [0, 1];
    const type = this.scene.types[t];
    const box = frameOf(this.canvases[t], this.scene.steps, low, high, ink, line, type.label);
    const { pen } = box;
    for (const [bin, means] of bins) {
      let [up, down] = [0, 0];
      const [x0, x1] = [box.x(bin), box.x(Math.min(bin + BIN, this.scene.steps))];
      means.forEach((value, k) => {
        const base = value > 0 ? up : down;
        pen.fillStyle = this.scene.parts[k].colour;
        pen.fillRect(x0, box.y(base + value), Math.max(1, x1 - x0), box.y(base) - box.y(base + value));
        if (value > 0) up += value;
        else down += value;
      });
    }
    this.cursor(box, past.at(number).step, ink);
  }

  cursor(box, step, ink) {
    const { pen } = box;
    pen.strokeStyle = ink;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(box.x(step), box.top);
    pen.lineTo(box.x(step), box.bottom);
    pen.stroke();
  }

  drawCourse(past, begin, number, ink, line, colours) {
    const most = Math.max(...this.scene.most);
    const box = frameOf(this.course, this.scene.steps, 0, most, ink, line, "mean age, units");
    const { pen } = box;
    [["AoI", colours[0], []], ["VDF", colours[1], [6, 3]]].forEach(([name, colour, dash], which) => {
      pen.strokeStyle = colour;
      pen.lineWidth = 2;
      pen.setLineDash(dash);
      pen.beginPath();
      for (let n = begin; n <= number; n++) pen.lineTo(box.x(past.at(n).step), box.y(Past.row(past.at(n), "level")[which]));
      pen.stroke();
      const x = box.right - 120 + 66 * which;
      pen.beginPath();
      pen.moveTo(x, 7);
      pen.lineTo(x + 22, 7);
      pen.stroke();
      pen.setLineDash([]);
      pen.fillStyle = ink;
      pen.textAlign = "left";
      pen.textBaseline = "middle";
      pen.fillText(name, x + 27, 7.5);
    });
    this.cursor(box, past.at(number).step, ink);
  }
}

export function drawScale(canvas, stops, most, ink, line) {
  const { pen, width } = prepare(canvas);
  const colours = ramp(stops);
  const wide = width - 16;
  for (let x = 0; x < wide; x++) {
    pen.fillStyle = css(colours[Math.round((x / Math.max(1, wide - 1)) * 255)]);
    pen.fillRect(8 + x, 2, 1.5, 11);
  }
  pen.strokeStyle = line;
  pen.strokeRect(8, 2, wide, 11);
  pen.fillStyle = ink;
  pen.font = "11px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "top";
  const step = niceStep(most / 5);
  for (let value = 0; value <= most; value += step) pen.fillText(value, 8 + (wide * value) / most, 16);
}
