// The WebSocket: takes packets apart, and comes back by itself when the command is started again.

const TYPES = { f4: Float32Array, u1: Uint8Array };
const AGAIN_MS = 1000;

// u32 header length | JSON header | arrays; see deploy/monitor/web/packets.py
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, type, shape, place] of header.arrays) {
    arrays[name] = new TYPES[type](buffer, 4 + length + place, shape.reduce((a, b) => a * b, 1));
    arrays[name].shape = shape;
  }
  return { ...header, arrays };
}

// Takes packets until the page is closed; returns a function that sends a text.
export function listen(take, lost) {
  let socket = null;
  const open = () => {
    socket = new WebSocket(`ws://${location.host}/stream`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => take(typeof data === "string" ? { kind: "dropped", ...JSON.parse(data) } : unpack(data));
    socket.onclose = () => {
      lost();
      setTimeout(open, AGAIN_MS);
    };
  };
  open();
  return (text) => socket.readyState === WebSocket.OPEN && socket.send(text);
}
