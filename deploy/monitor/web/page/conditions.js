// What only some farms have: no-fly zones, wind, patches of stress, stations, batteries, chains and UAVs that failed.

import { HOP_DASH, LINK, UAV, css, mark, rgb } from "./marks.js";
import { Past } from "./past.js";

const STATION = 15; // half the size of a station's mark, pixels: more than a UAV's, which may stand on it
const [SHORTEST, LONGEST] = [18, 44]; // the wind's arrow, pixels: that of a breeze can still be seen
const CALM = 0.05; // wind that is not shown, m/s: it would read as 0.0
const BAR = { width: 24, height: 5, below: UAV + 5 }; // of a UAV's charge, pixels

function polygon(field, pen, corners) {
  pen.beginPath();
  for (const [x, y] of corners) pen.lineTo(field.x(x), field.y(y));
  pen.closePath();
}

export function drawZones(field, pen, frame) {
  if (!field.scene.zone) return;
  pen.lineWidth = 1.5;
  pen.strokeStyle = field.scene.zone;
  pen.fillStyle = css(rgb(field.scene.zone), 0.2);
  for (const corners of frame.packet.zones) {
    polygon(field, pen, corners);
    pen.fill();
    pen.stroke();
  }
}

// Areas in which counters always rise faster.
export function drawAreas(field, pen) {
  const { areas } = field.scene;
  if (!areas) return;
  pen.lineWidth = 1.8;
  pen.strokeStyle = css(rgb(areas.colour), 0.85);
  for (const corners of areas.outlines) {
    polygon(field, pen, corners);
    pen.stroke();
  }
}

// An arrow beside the wind's speed, in the upper left corner of the field.
export function drawWind(field, pen, frame) {
  if (!frame.packet.arrays.wind) return;
  const [x, y] = Past.row(frame, "wind");
  const speed = Math.hypot(x, y);
  if (speed < CALM) return;
  const long = SHORTEST + (LONGEST - SHORTEST) * Math.min(speed / field.scene.top_speed, 1);
  const [left, top] = [field.x(0) + 34, field.y(field.scene.field[1]) + 34];
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

// Patches that are there at a frame's step: [x, y, whether the team knows it] each.
export function patchesAt(frame) {
  const { patches, arrays } = frame.packet;
  if (!patches) return [];
  const known = arrays.known ? Past.row(frame, "known") : null;
  return patches.flatMap(([x, y, first, end], k) =>
    first <= frame.step && frame.step < end ? [[x, y, Boolean(known && known[k])]] : []);
}

// A tinted disc; fainter and with a dashed edge while the team does not know it.
export function patch(pen, colour, x, y, radius, known) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fillStyle = css(rgb(colour), known ? 0.26 : 0.12);
  pen.fill();
  pen.setLineDash(known ? [] : [5, 4]);
  pen.lineWidth = 1.6;
  pen.strokeStyle = css(rgb(colour), known ? 0.85 : 0.5);
  pen.stroke();
  pen.setLineDash([]);
}

export function drawPatches(field, pen, frame) {
  const { stress } = field.scene;
  for (const [x, y, known] of patchesAt(frame)) {
    patch(pen, stress.colour, field.x(x), field.y(y), stress.radius * field.scale, known);
  }
}

// A hexagon, as in the other pictures.
export function station(pen, colour, x, y, size) {
  pen.beginPath();
  for (let k = 0; k < 6; k++) {
    const angle = (k * Math.PI) / 3;
    pen.lineTo(x + size * Math.cos(angle), y + size * Math.sin(angle));
  }
  pen.closePath();
  pen.lineWidth = 1.6;
  pen.strokeStyle = colour;
  pen.stroke();
}

export function drawStations(field, pen) {
  for (const [x, y] of field.scene.stations || []) station(pen, LINK.colour, field.x(x), field.y(y), STATION);
}

// Hops between joined relays, and from them to the base station, which stands on the ground.
function hops(field, frame) {
  const { place, height, range } = field.scene.base;
  const joined = Past.row(frame, "joined");
  const ends = [...joined.keys()].filter((relay) => joined[relay]).map((relay) => field.places[relay]);
  const near = ([x, y], [toX, toY], dz) => Math.hypot(toX - x, toY - y, dz) <= range;
  const pairs = ends.flatMap((one, k) => ends.slice(k + 1).filter((other) => near(one, other, 0)).map((other) => [one, other]));
  return [...pairs, ...ends.filter((one) => near(one, place, height)).map((one) => [one, place])];
}

export function drawChain(field, pen, frame) {
  if (!field.scene.base) return;
  pen.lineWidth = 2;
  pen.strokeStyle = field.scene.types[0].colour;
  pen.setLineDash(HOP_DASH);
  for (const ends of hops(field, frame)) {
    pen.beginPath();
    for (const [x, y] of ends) pen.lineTo(field.x(x), field.y(y));
    pen.stroke();
  }
  pen.setLineDash([]);
  const [x, y] = field.scene.base.place;
  baseStation(pen, field.x(x), field.y(y), UAV);
}

export function baseStation(pen, x, y, size) {
  mark(pen, "p", x, y, size);
  pen.lineWidth = 2;
  pen.strokeStyle = "#fff";
  pen.stroke();
  pen.fillStyle = LINK.colour;
  pen.fill();
}

export function isGone(frame, u) {
  return Boolean(frame.packet.arrays.gone) && Past.row(frame, "gone")[u] === 1;
}

// Where a UAV has failed.
export function cross(pen, colour, x, y, size) {
  pen.lineCap = "round";
  for (const [width, stroke] of [[6, "#fff"], [3, colour]]) {
    pen.lineWidth = width;
    pen.strokeStyle = stroke;
    pen.beginPath();
    for (const side of [-1, 1]) {
      pen.moveTo(x - size, y - side * size);
      pen.lineTo(x + size, y + side * size);
    }
    pen.stroke();
  }
  pen.lineCap = "butt";
}

export function drawCharges(field, pen, frame) {
  if (!frame.packet.arrays.charge) return;
  const charge = Past.row(frame, "charge");
  field.places.forEach(([x, y], u) => {
    if (isGone(frame, u)) return;
    const [left, top] = [field.x(x) - BAR.width / 2, field.y(y) + BAR.below];
    pen.fillStyle = "#fff";
    pen.fillRect(left - 1, top - 1, BAR.width + 2, BAR.height + 2);
    pen.fillStyle = LINK.colour;
    pen.fillRect(left, top, (BAR.width * charge[u]) / 255, BAR.height);
  });
}
