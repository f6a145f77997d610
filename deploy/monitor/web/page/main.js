// Wires everything together: packets in, the recent past, where in it we are, and what is drawn.

import { Farm } from "./farm.js";
import { by, colour, prepare } from "./marks.js";
import { Past } from "./past.js";
import { Steps } from "./steps.js";
import { listen } from "./stream.js";

const past = new Past();
const view = { scene: null, shown: null, field: null, head: 0, playing: true, drawn: "", losses: {}, dropped: 0, came: 0, settles: 0 };
const TEXT_MS = 100; // numbers change this often at most, so that they can be read
const NOTICE_MS = 8000;
const STILL_MS = 2000; // time without a frame after which the page says since when
const LIVE = 5; // steps behind that nobody notices
const SETTLES_MS = 500; // time in which a page that has been opened gets what was before it
const MOST_BEHIND = 1500; // steps, of the 2,048 that are kept
let theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";

function setTheme(name) {
  theme = name;
  document.documentElement.dataset.theme = name;
  by("theme").textContent = name === "dark" ? "light" : "dark";
  if (view.shown) view.shown.drawLegend();
  view.drawn = "";
}

function say(sentence, mood) {
  if (by("sentence").textContent !== sentence) by("sentence").textContent = sentence;
  by("dot").className = mood;
}

// Says something for a while.
function notice(text) {
  by("notice").textContent = text;
  by("notice").hidden = false;
  clearTimeout(notice.timer);
  notice.timer = setTimeout(() => { by("notice").hidden = true; }, NOTICE_MS);
}

const takers = {
  scene(packet) {
    const same = view.scene && JSON.stringify(view.scene) === JSON.stringify(packet);
    past.clear();
    view.head = 0;
    if (same) return;
    view.scene = packet;
    document.body.dataset.view = packet.agents ? "steps" : "farm";
    view.shown = packet.agents ? new Steps(packet) : new Farm(packet);
    view.field = view.shown.field;
    document.title = `${packet.title}, run ${packet.run}`;
    by("title").textContent = packet.title;
    by("who").textContent = `run ${packet.run}, worker ${packet.worker}`;
  },
  frames(packet) {
    if (!view.scene) return;
    const first = !past.frames.length;
    view.came = performance.now();
    past.add(packet);
    if (first) {
      tellState();
      view.settles = view.came + SETTLES_MS;
    }
    if (view.playing && view.came < view.settles) view.head = past.beginOf(past.last); // the newest episode
  },
  state(packet) {
    view.losses = packet;
    offer(packet.workers, packet.worker);
    tellState();
  },
  dropped(packet) {
    view.dropped = packet.dropped;
  },
};

function tellState() {
  const { sentence, wrong } = view.losses;
  const still = performance.now() - view.came;
  if (sentence) say(sentence, wrong ? "bad" : "");
  else if (!past.frames.length) say("waiting for the first frames", "");
  else if (view.head >= past.last && still > STILL_MS) say(`watching; last frame ${Math.round(still / 1000)} s ago`, "good");
  else say("watching", "good");
}

// The workers among which one can choose; none is marked while the chosen one is gone.
function offer(workers, chosen) {
  const select = by("worker");
  const before = [...select.options].map((option) => option.value);
  const changed = workers.join() !== before.join();
  by("workers").hidden = workers.every((name) => name === chosen);
  if (changed) select.replaceChildren(...workers.map((name) => new Option(name, name)));
  if (changed || document.activeElement !== select) select.value = chosen ?? "";
}

function writeNumbers(at) {
  const frame = past.at(at);
  view.shown.write(past, at);
  const { packet } = frame;
  const added = packet.noise_std ? `, noise ${packet.noise_std.toFixed(2)}` : "";
  const noise = packet.uniform ? "warm-up: random actions" : `policy version ${packet.version}${added}`;
  by("headline").replaceChildren(`${view.shown.headline(frame)} `);
  const soft = by("headline").appendChild(document.createElement("span"));
  soft.textContent = noise;
  const behind = past.last - at;
  by("clock").textContent = behind > LIVE ? `${behind.toLocaleString("en")} steps behind` : "newest step";
  const { lost = 0, malformed = 0, skipped = 0 } = view.losses;
  by("losses").textContent = `At most ${view.scene.pace} steps/s. Done and not shown: `
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

// Where in the past we are after so many seconds more.
function advance(seconds) {
  if (view.playing) view.head += seconds * Number(by("speed").value);
  if (view.head < past.first && !view.playing) notice("The step at which you stopped is no longer kept; this is the oldest one.");
  view.head = Math.min(Math.max(view.head, past.first), past.last);
  const behind = past.last - Math.floor(view.head);
  if (view.playing && behind > MOST_BEHIND) {
    notice(`${behind.toLocaleString("en")} steps behind: jumped to the newest episode.`);
    view.head = past.beginOf(past.last);
  }
}

let [before, texts] = [performance.now(), 0];

function tick(now) {
  const seconds = Math.min(0.25, (now - before) / 1000);
  before = now;
  if (past.frames.length) {
    advance(seconds);
    const at = Math.floor(view.head);
    const box = by("field-box").getBoundingClientRect();
    const state = [view.head.toFixed(2), past.last, box.width, box.height, devicePixelRatio, view.shown.mark].join();
    if (state !== view.drawn) {
      view.drawn = state;
      view.shown.draw(past, at, view.head - at);
      if (now - texts >= TEXT_MS || !view.playing) {
        texts = now;
        writeNumbers(at);
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
  const text = pointer && past.frames.length && view.shown.tell(past.at(Math.floor(view.head)), ...pointer);
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
addEventListener("resize", () => view.shown && view.shown.drawLegend());
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
const send = listen(
  (packet) => takers[packet.kind](packet),
  () => say("the connection to eia-sec watch is gone; trying again", "bad"),
);
by("worker").addEventListener("change", () => {
  past.clear();
  view.head = 0;
  send(by("worker").value);
});
requestAnimationFrame(tick);
// What the tests look at.
window.watching = { past, view };
