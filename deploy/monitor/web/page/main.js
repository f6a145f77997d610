// Wires everything together: packets in, the recent past, where in it we are, and what is drawn.

import { Charts, drawScale } from "./charts.js";
import { baseStation, cross, patch, station } from "./conditions.js";
import { Field } from "./field.js";
import { DOWN_DASH, HOP_DASH, LINK, css, mark, prepare, rgb, uav } from "./marks.js";
import { Past } from "./past.js";
import { listen } from "./stream.js";

const by = (id) => document.getElementById(id);
const past = new Past();
const view = { scene: null, field: null, charts: null, head: 0, playing: true, drawn: "", losses: {}, dropped: 0 };
const TEXT_MS = 100; // numbers change this often at most, so that they can be read
let theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function setTheme(name) {
  theme = name;
  document.documentElement.dataset.theme = name;
  by("theme").textContent = name === "dark" ? "light" : "dark";
  if (view.scene) drawLegend();
  view.drawn = "";
}

function say(sentence, mood) {
  by("sentence").textContent = sentence;
  by("dot").className = mood;
}

const takers = {
  scene(packet) {
    const same = view.scene && JSON.stringify(view.scene) === JSON.stringify(packet);
    past.clear();
    view.head = 0;
    if (same) return;
    view.scene = packet;
    view.field = new Field(by("field"), packet);
    view.charts = new Charts(packet, by("parts"), by("course"));
    by("who").textContent = `run ${packet.run}, worker ${packet.worker}`;
    makeRows();
    drawLegend();
  },
  frames(packet) {
    if (!view.scene) return;
    if (!past.frames.length && !view.losses.sentence) say("watching", "good");
    past.add(packet);
  },
  state(packet) {
    view.losses = packet;
    if (packet.sentence) say(packet.sentence, "bad");
    else say(past.frames.length ? "watching" : "waiting for the first frames", past.frames.length ? "good" : "");
  },
  dropped(packet) {
    view.dropped = packet.dropped;
  },
};

function icon(draw) {
  const canvas = document.createElement("canvas");
  canvas.className = "icon";
  queueMicrotask(() => draw(prepare(canvas).pen));
  return canvas;
}

function item(sign, text) {
  const line = document.createElement("li");
  line.append(sign, text);
  return line;
}

function swatch(fill) {
  const box = document.createElement("span");
  box.className = "swatch";
  box.style.background = fill;
  return box;
}

function makeRows() {
  const body = by("reward").tBodies[0];
  body.replaceChildren();
  for (const type of [...view.scene.types, null]) {
    const row = body.insertRow();
    const head = row.appendChild(document.createElement("th"));
    if (type) head.append(icon((pen) => uav(pen, type, 9, 9, 6, null, null)));
    head.append(type ? type.label : "all agents");
    if (!type) row.className = "all";
    row.insertCell();
    row.insertCell();
  }
  by("part-names").replaceChildren(...view.scene.parts.map((part) => item(swatch(part.colour), part.name)));
}

function drawLegend() {
  const [ink, line] = [colour("--ink"), colour("--line")];
  const { scene } = view;
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
    ...scene.cycles.map((cycle, kind) => item(icon((pen) => {
      mark(pen, scene.markers[kind], 9, 9, 5);
      pen.fillStyle = "#8a9296";
      pen.fill();
    }), `sensor that measures every ${cycle} s`)),
    ...conditionSigns(scene, ink, stroke),
  );
}

// The legend's lines for what only some farms have.
function conditionSigns(scene, ink, stroke) {
  const signs = [];
  const add = (text, draw) => signs.push(item(icon(draw), text));
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

function number(value, digits) {
  return value.toFixed(digits).replace("-", "\u2212");
}

function writeNumbers(frame) {
  const { scene } = view;
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
  const cover = view.field.coverage(frame);
  const level = Past.row(frame, "level");
  const cells = [...by("fresh").tBodies[0].rows].map((row) => [row.cells[1], row.cells[2]]);
  for (const which of [0, 1]) {
    cells[0][which].textContent = level[which].toFixed(2);
    cells[1][which].textContent = `${(100 * cover.fresh[which]).toFixed(0)} %`;
    cells[2][which].textContent = `${(100 * cover.reach[which]).toFixed(0)} %`;
  }
  const { packet } = frame;
  const added = packet.noise_std ? `, noise ${packet.noise_std.toFixed(2)}` : "";
  const noise = packet.uniform ? "warm-up: random actions" : `policy version ${packet.version}${added}`;
  by("headline").replaceChildren(`farm ${packet.farm}, step ${frame.step} of ${scene.steps} `);
  const soft = by("headline").appendChild(document.createElement("span"));
  soft.textContent = noise;
  const behind = past.last - Math.floor(view.head);
  by("clock").textContent = behind > 0 ? `${behind} steps behind` : "newest step";
  const { lost = 0, malformed = 0, skipped = 0 } = view.losses;
  by("losses").textContent = `Whole episodes, ${scene.pace} steps/s at most. Flown and not shown: `
    + `${skipped.toLocaleString("en")} steps. Messages lost: ${lost}, malformed: ${malformed}. `
    + `Frames dropped on the way to this page: ${view.dropped}.`;
}

function drawSlider() {
  const slider = by("slider");
  [slider.min, slider.max, slider.value] = [past.first, past.last, Math.floor(view.head)];
  const { pen, width } = prepare(by("episodes"));
  pen.fillStyle = colour("--line");
  pen.fillRect(8, 3, width - 16, 2);
  pen.fillStyle = colour("--soft");
  const span = Math.max(1, past.last - past.first);
  for (const begin of past.begins()) pen.fillRect(8 + ((width - 16) * (begin - past.first)) / span - 1, 0, 2, 8);
}

let [before, texts] = [performance.now(), 0];

function tick(now) {
  const seconds = Math.min(0.25, (now - before) / 1000);
  before = now;
  if (past.frames.length) {
    if (view.playing) view.head += seconds * Number(by("speed").value);
    view.head = Math.min(Math.max(view.head, past.first), past.last);
    const at = Math.floor(view.head);
    const box = by("field").getBoundingClientRect();
    const state = [view.head.toFixed(2), past.last, box.width, box.height, devicePixelRatio].join();
    if (state !== view.drawn) {
      view.drawn = state;
      const [ink, soft, line] = [colour("--ink"), colour("--soft"), colour("--line")];
      view.field.draw(past, at, view.head - at, soft, line);
      if (now - texts >= TEXT_MS || !view.playing) {
        texts = now;
        view.charts.draw(past, at, ink, line, [view.scene.types[2].colour, view.scene.types[1].colour]);
        writeNumbers(past.at(at));
        drawSlider();
        point();
      }
    }
  }
  requestAnimationFrame(tick);
}

function play(on) {
  view.playing = on;
  by("play").textContent = on ? "pause" : "play";
}

let pointer = null;

function point() {
  const tip = by("tip");
  const text = pointer && past.frames.length && view.field.tell(past.at(Math.floor(view.head)), ...pointer);
  tip.hidden = !text;
  if (!text) return;
  tip.textContent = text;
  const box = by("field-box").getBoundingClientRect();
  tip.style.left = `${Math.min(pointer[0] + 14, box.width - tip.offsetWidth - 4)}px`;
  tip.style.top = `${Math.max(4, pointer[1] - tip.offsetHeight - 10)}px`;
}

by("field").addEventListener("pointermove", (event) => {
  pointer = [event.offsetX, event.offsetY];
  point();
});
by("field").addEventListener("pointerleave", () => {
  pointer = null;
  point();
});
by("play").addEventListener("click", () => play(!view.playing));
by("slider").addEventListener("input", () => {
  play(false);
  view.head = Number(by("slider").value);
});
by("newest").addEventListener("click", () => {
  if (past.frames.length) view.head = past.beginOf(past.last);
  play(true);
});
by("theme").addEventListener("click", () => setTheme(theme === "dark" ? "light" : "dark"));
addEventListener("resize", () => view.scene && drawLegend());
document.addEventListener("keydown", (event) => {
  if (["SELECT", "BUTTON"].includes(event.target.tagName)) return;
  if (event.code === "Space") {
    event.preventDefault();
    play(!view.playing);
  } else if (["ArrowLeft", "ArrowRight"].includes(event.code) && event.target !== by("slider")) {
    play(false);
    view.head = Math.floor(view.head) + (event.code === "ArrowLeft" ? -1 : 1);
  }
});

setTheme(theme);
listen((packet) => takers[packet.kind](packet), () => say("the connection to eia-sec watch is gone; trying again", "bad"));
requestAnimationFrame(tick);
// What the tests look at.
window.watching = { past, view };
