// The map: plots by VDF, sensors by AoI, reach, trails, links and UAVs.

import { Past } from "./past.js";

const MARGIN = { left: 46, right: 12, top: 10, bottom: 34 };
const UAV = 11; // half the size of a UAV's mark, pixels
const NEAR = 14; // distance of the pointer to what it points at, pixels

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

export class Field {
  constructor(canvas, scene) {
    this.canvas = canvas;
    this.scene = scene;
    this.age = ramp(scene.age);
    this.soil = ramp(scene.soil);
    this.tiles = document.createElement("canvas");
    [this.tiles.width, this.tiles.height] = scene.plots;
    this.pixels = this.tiles.getContext("2d").createImageData(...scene.plots);
    this.owners = scene.types.flatMap((type) => Array.from({ length: type.count }, (_, n) => ({ type, n })));
    this.places = [];
  }

  // Draws the frame at a number, and the way to the next one by a share of 0..1.
  draw(past, number, share, ink, line) {
    const { pen, width, height } = prepare(this.canvas);
    const frame = past.at(number);
    const [fx, fy] = this.scene.field;
    this.scale = Math.min((width - MARGIN.left - MARGIN.right) / fx, (height - MARGIN.top - MARGIN.bottom) / fy);
    this.left = MARGIN.left;
    this.top = MARGIN.top;
    this.places = this.positions(past, number, share);
    this.drawSoil(pen, frame, ink, line);
    pen.save();
    pen.beginPath();
    pen.rect(this.x(0) - UAV, this.y(fy) - UAV, fx * this.scale + 2 * UAV, fy * this.scale + 2 * UAV);
    pen.clip();
    this.drawZones(pen, frame);
    this.drawReach(pen);
    this.drawTrails(pen, past, number);
    this.drawSensors(pen, frame);
    this.drawLinks(pen, frame);
    pen.restore();
    this.drawUavs(pen, past, number);
    this.drawWind(pen, frame);
  }

  x(metres) {
    return this.left + metres * this.scale;
  }

  y(metres) {
    return this.top + (this.scene.field[1] - metres) * this.scale;
  }

  positions(past, number, share) {
    const here = Past.row(past.at(number), "position");
    const next = past.at(number + 1);
    const there = next && next.begin !== number + 1 ? Past.row(next, "position") : here;
    return this.owners.map((_, u) => {
      const [x, y] = [here[2 * u], here[2 * u + 1]];
      return [x + (there[2 * u] - x) * share, y + (there[2 * u + 1] - y) * share];
    });
  }

  drawSoil(pen, frame, ink, line) {
    const [px, py] = this.scene.plots;
    const levels = Past.row(frame, "vdf");
    for (let a = 0; a < px; a++) {
      for (let b = 0; b < py; b++) {
        const place = 4 * ((py - 1 - b) * px + a);
        const [r, g, bl] = this.soil[levels[a * py + b]];
        this.pixels.data.set([r, g, bl, 255], place);
      }
    }
    this.tiles.getContext("2d").putImageData(this.pixels, 0, 0);
    const [fx, fy] = this.scene.field;
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.tiles, this.x(0), this.y(fy), fx * this.scale, fy * this.scale);
    pen.strokeStyle = line;
    pen.lineWidth = 1;
    pen.strokeRect(this.x(0), this.y(fy), fx * this.scale, fy * this.scale);
    pen.fillStyle = ink;
    pen.font = "12px system-ui, sans-serif";
    const step = niceStep(Math.max(fx, fy) / 5);
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (let at = 0; at <= fx; at += step) pen.fillText(at, this.x(at), this.y(0) + 5);
    pen.fillText("x, m", this.x(fx / 2), this.y(0) + 19);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let at = 0; at <= fy; at += step) pen.fillText(at, this.x(0) - 6, this.y(at));
    pen.save();
    pen.translate(this.x(0) - 36, this.y(fy / 2));
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText("y, m", 0, 0);
    pen.restore();
  }

  drawZones(pen, frame) {
    pen.lineWidth = 1.5;
    pen.strokeStyle = this.scene.zone;
    pen.fillStyle = css(rgb(this.scene.zone), 0.2);
    for (const corners of frame.packet.zones) {
      pen.beginPath();
      for (const [x, y] of corners) pen.lineTo(this.x(x), this.y(y));
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  }

  // An arrow beside the wind's speed, in the upper left corner of the field.
  drawWind(pen, frame) {
    if (!frame.packet.arrays.wind) return;
    const [x, y] = Past.row(frame, "wind");
    const speed = Math.hypot(x, y);
    if (speed < 0.05) return;
    const [long, left, top] = [(44 * speed) / this.scene.top_speed, this.x(0) + 34, this.y(this.scene.field[1]) + 34];
    const bearing = (Math.round((Math.atan2(-x, -y) * 180) / Math.PI) + 360) % 360;
    const text = `wind ${speed.toFixed(1)} m/s from ${String(bearing).padStart(3, "0")}\u00b0`;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillStyle = "rgba(255,255,255,0.8)";
    pen.fillRect(left + 26, top - 10, pen.measureText(text).width + 8, 20);
    pen.fillStyle = "#222";
    pen.fillText(text, left + 30, top);
    pen.save();
    pen.translate(left, top);
    pen.rotate(Math.atan2(-y, x));
    pen.strokeStyle = "#222";
    pen.lineWidth = 3;
    pen.beginPath();
    pen.moveTo(-long / 2, 0);
    pen.lineTo(long / 2, 0);
    pen.moveTo(long / 2 - 8, -6);
    pen.lineTo(long / 2, 0);
    pen.lineTo(long / 2 - 8, 6);
    pen.stroke();
    pen.restore();
  }

  drawReach(pen) {
    pen.lineWidth = 1;
    this.owners.forEach(({ type }, u) => {
      const radius = this.scene.reach[type.name];
      if (!radius) return;
      const [x, y] = this.places[u];
      pen.beginPath();
      pen.arc(this.x(x), this.y(y), radius * this.scale, 0, 2 * Math.PI);
      pen.fillStyle = css(rgb(type.colour), 0.16);
      pen.fill();
      pen.strokeStyle = css(rgb(type.colour), 0.9);
      pen.stroke();
    });
  }

  drawTrails(pen, past, number) {
    const oldest = Math.max(past.beginOf(number), number - this.scene.trail);
    pen.lineWidth = 2.5;
    pen.lineCap = "round";
    this.owners.forEach(({ type }, u) => {
      for (let n = oldest; n <= number; n++) {
        const from = Past.row(past.at(n), "position");
        const to = n < number ? Past.row(past.at(n + 1), "position") : null;
        const [x, y] = to ? [to[2 * u], to[2 * u + 1]] : this.places[u];
        pen.strokeStyle = css(rgb(type.colour), 0.85 * (1 - (number - n) / (this.scene.trail + 1)));
        pen.beginPath();
        pen.moveTo(this.x(from[2 * u]), this.y(from[2 * u + 1]));
        pen.lineTo(this.x(x), this.y(y));
        pen.stroke();
      }
    });
  }

  drawSensors(pen, frame) {
    const { sensor, kind } = frame.packet.arrays;
    const ages = Past.row(frame, "aoi");
    const size = Math.max(2, Math.min(4.2, (this.scale * this.scene.field[0]) / 160));
    pen.lineWidth = 0.8;
    pen.strokeStyle = "rgba(40,40,40,0.75)";
    for (let s = 0; s < ages.length; s++) {
      mark(pen, this.scene.markers[kind[s]], this.x(sensor[2 * s]), this.y(sensor[2 * s + 1]), size);
      pen.fillStyle = css(this.age[ages[s]]);
      pen.fill();
      pen.stroke();
    }
  }

  drawLinks(pen, frame) {
    const relays = this.scene.types[0].count;
    pen.strokeStyle = "#222";
    pen.lineWidth = 1.4;
    pen.setLineDash([2, 3]);
    Past.row(frame, "assignment").forEach((relay, served) => {
      if (relay >= relays) return; // 255: no relay
      pen.beginPath();
      for (const [x, y] of [this.places[relay], this.places[relays + served]]) pen.lineTo(this.x(x), this.y(y));
      pen.stroke();
    });
    pen.setLineDash([]);
  }

  // Unit vector in which a UAV flies, in the canvas's sense, or null when it hovers.
  heading(past, number, u) {
    const next = past.at(number + 1);
    const [a, b] = next && next.begin !== number + 1 ? [past.at(number), next]
      : past.at(number).begin !== number && past.at(number - 1) ? [past.at(number - 1), past.at(number)] : [];
    if (!a) return null;
    const [from, to] = [Past.row(a, "position"), Past.row(b, "position")];
    const [dx, dy] = [to[2 * u] - from[2 * u], to[2 * u + 1] - from[2 * u + 1]];
    const way = Math.hypot(dx, dy);
    return way > 0.05 ? [dx / way, -dy / way, way / this.scene.step_seconds] : null;
  }

  drawUavs(pen, past, number) {
    this.headings = this.owners.map((_, u) => this.heading(past, number, u));
    this.owners.forEach(({ type, n }, u) => {
      const [x, y] = this.places[u];
      uav(pen, type, this.x(x), this.y(y), UAV, n, this.headings[u]);
    });
  }

  // What is under the pointer, in words, or null.
  tell(frame, px, py) {
    let [best, text] = [NEAR, null];
    this.places.forEach(([x, y], u) => {
      const away = Math.hypot(this.x(x) - px, this.y(y) - py);
      if (away <= best) [best, text] = [away, () => this.tellUav(frame, u)];
    });
    if (!text) {
      const { sensor } = frame.packet.arrays;
      for (let s = 0; s < sensor.length / 2; s++) {
        const away = Math.hypot(this.x(sensor[2 * s]) - px, this.y(sensor[2 * s + 1]) - py);
        if (away <= Math.min(best, 8)) [best, text] = [away, () => this.tellSensor(frame, s)];
      }
    }
    return text && text();
  }

  tellUav(frame, u) {
    const { type, n } = this.owners[u];
    const [x, y] = this.places[u];
    const speed = this.headings[u] ? this.headings[u][2] : 0;
    const lines = [`${type.label} UAV ${n}`, `x ${x.toFixed(1)} m, y ${y.toFixed(1)} m`, `${speed.toFixed(1)} m/s`];
    const served = u - this.scene.types[0].count;
    if (served >= 0) {
      const quality = Past.row(frame, "quality")[served];
      const relay = Past.row(frame, "assignment")[served];
      lines.push(relay < this.scene.types[0].count ? `relay ${relay}, link ${quality.toFixed(1)} dB over noise` : "no relay");
    } else lines.push(`serves ${Past.row(frame, "assignment").filter((relay) => relay === n).length} UAVs`);
    return lines.join("\n");
  }

  tellSensor(frame, s) {
    const { sensor, kind } = frame.packet.arrays;
    const age = (Past.row(frame, "aoi")[s] / 255) * this.scene.most[0];
    return `sensor ${s}, every ${this.scene.cycles[kind[s]]} s\n`
      + `x ${sensor[2 * s].toFixed(1)} m, y ${sensor[2 * s + 1].toFixed(1)} m\nAoI ${+age.toFixed(2)} units`;
  }

  // Shares of sensors and of plots that are fresh, and that a UAV reaches now.
  coverage(frame) {
    const { sensor } = frame.packet.arrays;
    const [px, py] = this.scene.plots;
    const [fx, fy] = this.scene.field;
    const fresh = (name) => Past.row(frame, name).reduce((sum, age) => sum + (age === 0), 0) / Past.row(frame, name).length;
    const near = (type, x, y) => this.owners.some((owner, u) => owner.type.name === type
      && Math.hypot(this.places[u][0] - x, this.places[u][1] - y) <= this.scene.reach[type]);
    let [sensors, plots] = [0, 0];
    for (let s = 0; s < sensor.length / 2; s++) sensors += near("collection", sensor[2 * s], sensor[2 * s + 1]);
    for (let a = 0; a < px; a++) {
      for (let b = 0; b < py; b++) plots += near("monitoring", ((a + 0.5) * fx) / px, ((b + 0.5) * fy) / py);
    }
    return { fresh: [fresh("aoi"), fresh("vdf")], reach: [sensors / (sensor.length / 2), plots / (px * py)] };
  }
}

export function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough * 0.999);
}
