// The board's worker. It runs the release ELF in real time, or as fast as it can, and sends the page a server's
// messages.
import { Module } from "./module.js";

const TICK = 30; // ms between two pictures
const PIECE = 8; // ms of work between two checks for messages of the page
const BEHIND = 40; // ms of delay that it catches up; a longer delay is dropped
const MEASURED = 500; // ms over which the speed is measured

let module, image, runs = false, hidden = false, awaited = false;
let wall = 0, done = 0, speed = 1, since = 0, sinceDone = 0, tick = 0;

function tell(text) { postMessage(text); }

function begin() {
  const now = performance.now();
  [wall, done, since, sinceDone, tick] = [now, 0, now, 0, 0];
}

// Runs the board for the milliseconds that have passed since `wall`.
function work() {
  awaited = false;
  if (!runs || hidden) return;
  const begun = performance.now();
  let now = begun;
  while (done < now - wall && now - begun < PIECE) {
    const ms = Math.min(Math.ceil(now - wall - done), 4);
    if (!module.ask({ ask: "run", ms, speed }).runs) runs = false;
    done += ms;
    now = performance.now();
    if (!runs) break;
  }
  const late = now - wall - done;
  if (late > BEHIND) wall += late - BEHIND / 2;
  if (now - since > MEASURED) {
    const before = speed;
    speed = (done - sinceDone) / (now - since);
    [since, sinceDone] = [now, done];
    if (Math.abs(speed - before) > .005) postMessage({ speed });
  }
  if (now - tick > TICK || !runs) {
    tick = Math.max(tick + TICK, now - TICK);
    show();
    if (!runs) return show(); // every other answer has the state
  }
  awaited = true;
  if (late > 0) turn.port2.postMessage(null);
  else setTimeout(work, 2);
}

// Continues without a timer's delay.
const turn = new MessageChannel();
turn.port1.onmessage = work;

function show() {
  const answer = module.ask({ ask: "tick" });
  const state = answer.text ? new TextDecoder().decode(answer.bytes.pop()) : null;
  for (const { buffer } of answer.bytes) postMessage(buffer, [buffer]);
  if (state) tell(state);
}

const does = {
  async start({ compiled, elf, scene, text, board, core }) {
    module ??= await Module.of(compiled);
    image = elf;
    const { bytes } = module.ask({ ask: "start", scene, text, board, core }, image);
    tell(new TextDecoder().decode(bytes[0]));
    runs = true;
    begin();
    work();
  },
  say({ message }) {
    const answer = module.ask({ ask: "say", message });
    if (answer.refused) tell(answer.refused);
    if (answer.predict) postMessage({ predict: answer.predict });
  },
  rows({ from, rows, id }) {
    const { bytes } = module.ask({ ask: "rows", from, rows });
    postMessage({ id, rows: new TextDecoder().decode(bytes[0]) });
  },
  // While the page is hidden the board is paused: its time is the only clock of its firmware.
  hidden({ value }) {
    if (hidden === value) return;
    hidden = value;
    if (hidden || !runs) return;
    begin();
    if (!awaited) work();
  },
};

onmessage = async ({ data }) => {
  try {
    await does[data.do](data);
  } catch (error) {
    runs = false;
    postMessage({ failed: error.message });
  }
};
