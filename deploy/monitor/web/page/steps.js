// Any environment but a farm: the newest picture of it, and what each agent earned, did and saw.

import { frameOf } from "./charts.js";
import { by, colour, item, number, prepare, swatch } from "./marks.js";
import { Past } from "./past.js";

const MOST_ROWS = 64; // agents in the table
const MOST_NUMBERS = 4; // numbers of an action
const DASHES = [[], [6, 3], [2, 3], [9, 3, 2, 3]]; // of types, in their order

export class Steps {
  constructor(scene) {
    this.scene = scene;
    this.picture = null; // what is shown: {key, image}
    this.longest = 1; // step that an episode has reached, so that the chart's axis is steady
    this.asked = ""; // key of the picture that is being unpacked
    const types = scene.types.flatMap((type) => Array.from({ length: type.count }, () => type));
    const action = scene.types.flatMap((type) => Array.from({ length: type.count }, () => type.actions));
    let begin = 0;
    this.agents = scene.agents.map((name, n) => {
      const found = { name, type: types[n], begin, end: begin + action[n] };
      begin = found.end;
      return found;
    });
    this.makeRows();
  }

  drawLegend() {}

  headline(frame) {
    return `step ${frame.step} of an episode,`;
  }

  tell() {
    return null;
  }

  draw(past, at) {
    const found = pictureOf(past, at);
    by("silence").hidden = Boolean(found);
    by("picture").hidden = !found;
    if (!found) {
      const { silence } = past.at(at).packet;
      by("silence").textContent = silence
        ? `No pictures: ${silence.replace(/\.$/, "")}. The agents' numbers come all the same; eia-sec monitor shows the run's `
          + "progress in a terminal."
        : "Pictures, where the environment draws any, begin with its next episode.";
      return;
    }
    if (found.key !== this.asked) {
      this.asked = found.key;
      createImageBitmap(new Blob([found.bytes], { type: "image/png" })).then((image) => {
        if (this.asked === found.key) this.picture = { key: found.key, image };
      }, () => {});
    }
    if (!this.picture) return;
    const { pen, width, height } = prepare(by("picture"));
    const { image } = this.picture;
    const scale = Math.min(width / image.width, height / image.height);
    pen.imageSmoothingEnabled = scale < 3; // pixel art stays sharp
    pen.drawImage(image, 0, 0, image.width * scale, image.height * scale);
    by("picture").setAttribute("aria-label", `render() of ${this.scene.title} after step ${found.step}`);
  }

  // What has to change for another drawing although the frame is the same.
  get mark() {
    return this.picture ? this.picture.key : "";
  }

  write(past, at) {
    const frame = past.at(at);
    const rewards = Past.row(frame, "parts");
    const [actions, seen, alive] = ["action", "seen", "alive"].map((name) => Past.row(frame, name));
    const rows = by("agents").tBodies[0].rows;
    const over = !alive.some(Boolean); // at its end an episode has no agents
    this.agents.slice(0, MOST_ROWS).forEach((agent, n) => {
      const acted = frame.step > 0;
      const cells = [
        acted ? number(rewards[n], 2) : "\u2013",
        number(frame.sum[n], 1),
        acted ? told(agent, actions) : "\u2013",
        ...[0, 1, 2].map((k) => number(seen[3 * n + k], 2)),
      ];
      cells.forEach((text, k) => { rows[n].cells[k + 1].textContent = text; });
      rows[n].className = alive[n] || over ? "" : "gone";
    });
    by("sum-since").textContent = frame.since ? `since step ${frame.since}` : "so far";
    this.drawRewards(past, at);
  }

  makeRows() {
    const body = by("agents").tBodies[0];
    body.replaceChildren();
    for (const agent of this.agents.slice(0, MOST_ROWS)) {
      const row = body.insertRow();
      const head = row.appendChild(document.createElement("th"));
      head.scope = "row";
      head.append(swatch(agent.type.colour), ` ${agent.name}`);
      for (let k = 0; k < 6; k++) row.insertCell();
    }
    const more = this.agents.length - MOST_ROWS;
    by("more").textContent = more > 0 ? `and ${more} more agents` : "";
    by("type-names").replaceChildren(...this.scene.types.map((type) => item(swatch(type.colour), type.name)));
  }

  // Mean reward of each type in each step of the episode.
  drawRewards(past, at) {
    const begin = past.beginOf(at);
    let last = at;
    while (past.at(last + 1) && past.at(last + 1).begin === past.at(at).begin) last += 1;
    const rows = [];
    for (let n = begin; n <= at; n++) if (past.at(n).step > 0) rows.push([past.at(n).step, Past.row(past.at(n), "parts")]);
    let place = 0;
    const lines = this.scene.types.map((type) => {
      const [from, to] = [place, (place += type.count)];
      return rows.map(([step, row]) => [step, row.subarray(from, to).reduce((a, b) => a + b, 0) / type.count]);
    });
    const values = lines.flat().map(([, value]) => value);
    const [low, high] = [Math.min(0, ...values), Math.max(0, ...values)];
    const [ink, line] = [colour("--ink"), colour("--line")];
    const top = high - low < 1e-9 ? low + 1 : high;
    this.longest = Math.max(this.longest, past.at(last).step);
    const box = frameOf(by("rewards"), this.longest, low, top, ink, line, "reward of a step");
    const { pen } = box;
    lines.forEach((points, t) => {
      pen.strokeStyle = this.scene.types[t].colour;
      pen.setLineDash(DASHES[t % DASHES.length]);
      pen.lineWidth = 2;
      pen.beginPath();
      for (const [step, value] of points) pen.lineTo(box.x(step), box.y(value));
      pen.stroke();
    });
    pen.setLineDash([]);
  }
}

// The newest picture of a frame's stretch up to it, or null.
function pictureOf(past, at) {
  for (let n = at; n >= past.beginOf(at); n--) {
    const { packet, i, step } = past.at(n);
    const { ends, pictures } = packet.arrays;
    const begin = i ? ends[i - 1] : 0;
    if (ends[i] > begin) return { key: `${packet.episode}/${step}`, bytes: pictures.subarray(begin, ends[i]), step };
  }
  return null;
}

// An agent's action: its numbers, or which options it took.
function told(agent, actions) {
  const mine = [...actions.subarray(agent.begin, agent.end)];
  const chose = agent.type.choices.length > 0;
  const shown = mine.slice(0, MOST_NUMBERS).map((value) => (chose ? String(Math.round(value)) : number(value, 2)));
  return (chose ? "option " : "") + shown.join(", ") + (mine.length > MOST_NUMBERS ? ", \u2026" : "");
}
