// The recent past: frames by a number that only grows, oldest ones forgotten.

const LIMIT = 2048;

export class Past {
  constructor() {
    this.clear();
  }

  clear() {
    this.frames = [];
    this.first = 0; // number of the oldest frame that is kept
  }

  get last() {
    return this.first + this.frames.length - 1;
  }

  at(number) {
    return this.frames[number - this.first];
  }

  // Adds a packet's frames. A frame: packet, i (which one in it), step, begin (number of its stretch's first frame,
  // after which no step is missing), since (that frame's step), sum (reward per agent of each type since then).
  add(packet) {
    const [count, types, parts] = packet.arrays.parts.shape;
    for (let i = 0; i < count; i++) {
      const step = packet.first + i;
      const before = this.frames[this.frames.length - 1];
      const goesOn = before && before.packet.farm === packet.farm && before.packet.episode === packet.episode
        && before.step + 1 === step;
      const number = this.first + this.frames.length;
      const sum = goesOn ? Float64Array.from(before.sum) : new Float64Array(types);
      for (let t = 0; t < types; t++) {
        for (let k = 0; k < parts; k++) sum[t] += packet.arrays.parts[(i * types + t) * parts + k];
      }
      this.frames.push({
        packet, i, step, sum, begin: goesOn ? before.begin : number, since: goesOn ? before.since : step,
      });
    }
    const over = this.frames.length - LIMIT;
    if (over > 0) {
      this.frames.splice(0, over);
      this.first += over;
    }
  }

  // Number of the oldest kept frame of a frame's stretch.
  beginOf(number) {
    return Math.max(this.first, this.at(number).begin);
  }

  // Numbers at which stretches begin.
  begins() {
    const found = [];
    for (let n = this.first; n <= this.last; n++) if (n === this.first || this.at(n).begin === n) found.push(n);
    return found;
  }

  // Row i of an array whose first axis are frames.
  static row(frame, name) {
    const array = frame.packet.arrays[name];
    const width = array.length / array.shape[0];
    return array.subarray(frame.i * width, (frame.i + 1) * width);
  }
}
