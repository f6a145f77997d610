// The map: plots by VDF, sensors by AoI, reach, trails, links and UAVs.

import {
  cross, drawAreas, drawChain, drawCharges, drawPatches, drawStations, drawWind, drawZones, isGone,
} from "./conditions.js";
import { DOWN_DASH, LINK, UAV, css, mark, niceStep, prepare, ramp, rgb, uav } from "./marks.js";
import { Past } from "./past.js";

const MARGIN = { left: 46, right: 12, top: 10, bottom: 34 };
const NEAR = 14; // distance of the pointer to what it points at, pixels

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
    if (Math.min(width, height) < 100) return; // the page is not laid out yet
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
    drawZones(this, pen, frame);
    drawAreas(this, pen);
    drawPatches(this, pen, frame);
    this.drawReach(pen, frame);
    drawStations(this, pen);
    this.drawTrails(pen, past, number);
    this.drawSensors(pen, frame);
    this.drawLinks(pen, frame);
    drawChain(this, pen, frame);
    pen.restore();
    this.drawUavs(pen, past, number);
    drawCharges(this, pen, frame);
    drawWind(this, pen, frame);
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

  drawReach(pen, frame) {
    pen.lineWidth = 1;
    this.owners.forEach(({ type }, u) => {
      const radius = this.scene.reach[type.name];
      if (!radius || isGone(frame, u)) return;
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
    const { link_down: down } = this.scene;
    const linked = down && Past.row(frame, "linked");
    Past.row(frame, "assignment").forEach((relay, served) => {
      if (relay >= relays) return; // 255: no relay
      const up = !down || linked[served];
      pen.strokeStyle = up ? LINK.colour : down.colour;
      pen.setLineDash(up ? LINK.dash : DOWN_DASH);
      pen.lineWidth = up ? 1.4 : 1.8;
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
      if (isGone(past.at(number), u)) cross(pen, this.scene.gone, this.x(x), this.y(y), UAV * 0.8);
      else uav(pen, type, this.x(x), this.y(y), UAV, n, this.headings[u]);
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
    if (isGone(frame, u)) return `${type.label} UAV ${n}\nfailed at x ${x.toFixed(1)} m, y ${y.toFixed(1)} m`;
    const speed = this.headings[u] ? this.headings[u][2] : 0;
    const lines = [`${type.label} UAV ${n}`, `x ${x.toFixed(1)} m, y ${y.toFixed(1)} m`, `${speed.toFixed(1)} m/s`];
    const served = u - this.scene.types[0].count;
    if (served >= 0) {
      const quality = Past.row(frame, "quality")[served];
      const relay = Past.row(frame, "assignment")[served];
      const broken = this.scene.link_down && !Past.row(frame, "linked")[served] ? this.why(frame, relay) : "";
      lines.push(relay < this.scene.types[0].count
        ? `relay ${relay}, link ${quality.toFixed(1)} dB over noise${broken}` : "no relay");
    } else lines.push(`serves ${Past.row(frame, "assignment").filter((relay) => relay === n).length} UAVs`);
    if (served < 0 && this.scene.base) lines.push(Past.row(frame, "joined")[n] ? "joined" : "not joined");
    if (frame.packet.arrays.charge) lines.push(`charge ${(Past.row(frame, "charge")[u] / 2.55).toFixed(0)} %`);
    return lines.join("\n");
  }

  // Why a link to a relay does not count.
  why(frame, relay) {
    return this.scene.base && !Past.row(frame, "joined")[relay] ? ", relay not joined" : ", out of range";
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
    const near = (type, x, y) => this.owners.some((owner, u) => owner.type.name === type && !isGone(frame, u)
      && Math.hypot(this.places[u][0] - x, this.places[u][1] - y) <= this.scene.reach[type]);
    let [sensors, plots] = [0, 0];
    for (let s = 0; s < sensor.length / 2; s++) sensors += near("collection", sensor[2 * s], sensor[2 * s + 1]);
    for (let a = 0; a < px; a++) {
      for (let b = 0; b < py; b++) plots += near("monitoring", ((a + 0.5) * fx) / px, ((b + 0.5) * fy) / py);
    }
    return { fresh: [fresh("aoi"), fresh("vdf")], reach: [sensors / (sensor.length / 2), plots / (px * py)] };
  }
}
