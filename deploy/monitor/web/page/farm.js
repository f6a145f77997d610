// A farm: map, charts, tables and legend.

import { Charts, drawScale } from "./charts.js";
import { baseStation, cross, patch, station } from "./conditions.js";
import { Field } from "./field.js";
import { DOWN_DASH, HOP_DASH, LINK, by, colour, css, icon, item, mark, number, rgb, swatch, uav } from "./marks.js";
import { Past } from "./past.js";

export class Farm {
  constructor(scene) {
    this.scene = scene;
    this.field = new Field(by("field"), scene);
    this.charts = new Charts(scene, by("parts"), by("course"));
    this.makeRows();
    this.drawLegend();
  }

  // Draws the frame at a number, and the way to the next one by a share of 0..1.
  draw(past, at, share) {
    this.field.draw(past, at, share, colour("--soft"), colour("--line"));
  }

  // What frames are called that are not drawn in between: the headline.
  headline(frame) {
    const { scene } = this;
    const seconds = (frame.step * scene.step_seconds).toLocaleString("en");
    return `farm ${frame.packet.farm}, step ${frame.step} of ${scene.steps} (${seconds} s)`;
  }

  // Charts and numbers, which change too often to be read when they are drawn with each frame.
  write(past, at) {
    const { scene } = this;
    const frame = past.at(at);
    this.charts.draw(past, at, colour("--ink"), colour("--line"), [scene.types[2].colour, scene.types[1].colour]);
    const K = scene.parts.length;
    const parts = Past.row(frame, "parts");
    const counts = scene.types.map((type) => type.count);
    const agents = counts.reduce((a, b) => a + b);
    const now = scene.types.map((_, t) => parts.subarray(t * K, (t + 1) * K).reduce((a, b) => a + b, 0));
    const mean = (values) => values.reduce((sum, value, t) => sum + value * counts[t], 0) / agents;
    const rows = by("reward").tBodies[0].rows;
    [...now, mean(now)].forEach((value, t) => { rows[t].cells[1].textContent = number(value, 2); });
    [...frame.sum, mean([...frame.sum])].forEach((value, t) => { rows[t].cells[2].textContent = number(value, 1); });
    by("since").textContent = frame.since ? `since step ${frame.since}` : "so far";
    const cover = this.field.coverage(frame);
    const level = Past.row(frame, "level");
    const cells = [...by("fresh").tBodies[0].rows].map((row) => [row.cells[1], row.cells[2]]);
    for (const which of [0, 1]) {
      cells[0][which].textContent = level[which].toFixed(2);
      cells[1][which].textContent = `${(100 * cover.fresh[which]).toFixed(0)} %`;
      cells[2][which].textContent = `${(100 * cover.reach[which]).toFixed(0)} %`;
    }
  }

  // What is under the pointer, in words, or null.
  tell(frame, x, y) {
    return this.field.tell(frame, x, y);
  }

  makeRows() {
    for (const card of ["reward-card", "parts-card"]) by(card).hidden = !this.scene.parts.length; // as in a flight
    const body = by("reward").tBodies[0];
    body.replaceChildren();
    for (const type of [...this.scene.types, null]) {
      const row = body.insertRow();
      const head = row.appendChild(document.createElement("th"));
      if (type) head.append(icon((pen) => uav(pen, type, 9, 9, 6, null, null)));
      head.append(type ? type.label : "all agents");
      if (!type) row.className = "all";
      row.insertCell();
      row.insertCell();
    }
    by("part-names").replaceChildren(...this.scene.parts.map((part) => item(swatch(part.colour), part.name)));
  }

  drawLegend() {
    const { scene } = this;
    const [ink, line] = [colour("--ink"), colour("--line")];
    drawScale(by("age-scale"), scene.age, scene.most[0], ink, line);
    drawScale(by("soil-scale"), scene.soil, scene.most[1], ink, line);
    const ring = (type, text) => item(icon((pen) => {
      pen.arc(9, 9, 7, 0, 2 * Math.PI);
      pen.fillStyle = css(rgb(type.colour), 0.2);
      pen.fill();
      pen.strokeStyle = type.colour;
      pen.stroke();
    }), text);
    const stroke = (dash, text, shade = ink) => item(icon((pen) => {
      pen.setLineDash(dash);
      pen.lineWidth = dash.length ? 1.5 : 3;
      pen.strokeStyle = shade;
      pen.moveTo(0, 9);
      pen.lineTo(18, 9);
      pen.stroke();
    }), text);
    const [, monitoring, collection] = scene.types;
    by("signs").replaceChildren(
      ring(monitoring, `camera of a monitoring UAV, ${scene.reach.monitoring.toFixed(0)} m`),
      ring(collection, `half of all packets arrive, ${scene.reach.collection.toFixed(0)} m`),
      stroke(LINK.dash, "relay and whom it serves"),
      stroke([], `trail, last ${scene.trail} steps; arrowhead: heading`),
      sensorSigns(scene),
      ...conditionSigns(scene, ink, stroke),
    );
  }
}

// One line for all types of sensor.
function sensorSigns(scene) {
  const line = item("sensor, every", "");
  scene.cycles.forEach((cycle, kind) => {
    const type = line.appendChild(document.createElement("span"));
    type.append(icon((pen) => {
      mark(pen, scene.markers[kind], 9, 9, 5);
      pen.fillStyle = "#8a9296";
      pen.fill();
    }), `${cycle} s`);
  });
  return line;
}

// The legend's lines for what only some farms have.
function conditionSigns(scene, ink, stroke) {
  const signs = [];
  const add = (text, draw) => signs.push(item(icon(draw), text));
  if (scene.zone) {
    add("no-fly zone", (pen) => {
      pen.rect(2, 3, 14, 12);
      pen.lineWidth = 1.5;
      pen.strokeStyle = scene.zone;
      pen.fillStyle = css(rgb(scene.zone), 0.2);
      pen.fill();
      pen.stroke();
    });
  }
  if (scene.link_down) {
    const hops = scene.base ? ", or without hops" : "";
    const { range, colour: shade } = scene.link_down;
    signs.push(stroke(DOWN_DASH, `link out of range, ${range.toFixed(0)} m${hops}`, shade));
  }
  if (scene.base) {
    add("base station", (pen) => baseStation(pen, 9, 9, 6));
    signs.push(stroke(HOP_DASH, `hop to it, at most ${scene.base.range.toFixed(0)} m`, scene.types[0].colour));
  }
  if (scene.stations) add("charging station; bar: charge of a UAV", (pen) => station(pen, ink, 9, 9, 7));
  if (scene.gone) add("UAV that has failed", (pen) => cross(pen, scene.gone, 9, 9, 5));
  if (scene.stress) {
    add("patch of stress; dashed: not found yet", (pen) => patch(pen, scene.stress.colour, 9, 9, 7, true));
  }
  if (scene.areas) {
    add("area of faster growth", (pen) => {
      pen.lineWidth = 1.8;
      pen.strokeStyle = scene.areas.colour;
      pen.strokeRect(2, 4, 14, 10);
    });
  }
  return signs;
}
