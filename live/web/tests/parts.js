// Pieces of the page without the others: what is hard to bring about. .ci/web runs this in the page; each row of the
// result is what is tried, what came of it, and what should come.
const said = {};
const failed = (promise) => promise.then(() => "no error", (error) => error.message);
// A module that ends while it takes a question in.
const { Module } = await import("./assets/module.js");
const trap = () => { throw new WebAssembly.RuntimeError("unreachable"); };
const memory = new WebAssembly.Memory({ initial: 1 });
const none = () => 0;
const module = new Module({ memory, zwidth_input: trap, zwidth_answer_at: none, zwidth_answer_length: none });
try { module.ask({}); } catch (error) { said.module = error.ended === true; }
// Workers that say nothing.
const { Pool } = await import("./assets/pool.js");
const made = [], Real = Worker;
window.Worker = class {
  constructor() { made.push(this); }
  postMessage(job) { this.job = job; }
  terminate() { this.ended = true; }
};
const pool = new Pool(Promise.resolve(null), "");
pool.size = 2;
const study = failed(pool.ask({})), plane = failed(pool.ask({}, "predict")), waiting = failed(pool.ask({}));
const kept = failed(pool.ask({}, "scene"));
await Promise.resolve();
pool.end();
said.ended = [await study, await waiting, made.length];
await Promise.resolve();
for (const worker of made.filter(({ ended }) => !ended))
  worker.onmessage({ data: { id: worker.job.id, answer: 1 } });
said.kept = [await plane, await kept];
const [idle] = pool.idle;
idle.onerror({ message: "gone" });
said.idle = [pool.idle.includes(idle), pool.workers.has(idle)];
window.Worker = Real;
// A board that never answers for its rows.
const { link } = zwidth.web, worker = link.worker;
link.worker = { postMessage() {}, terminate() {} };
const rows = failed(link.rows(0, 10));
link.end("it has ended");
link.worker = worker;
said.rows = await rows;
return [
  ["a module that ends while it is asked is not asked again", said.module, true],
  ["End it ends the studies", said.ended, ["ended", "ended", 3]],
  ["and neither the plane's question nor a device's", said.kept, ["no error", "no error"]],
  ["a worker that ends with nothing to do is not asked again", said.idle, [false, false]],
  ["rows of a board that has ended are not waited for", said.rows, "it has ended"],
];
