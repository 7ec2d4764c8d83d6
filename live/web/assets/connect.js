// The page's connection: to its own worker with the release ELF on the virtual board. No data leaves the browser.
import { Link } from "./link.js";
import { Pool } from "./pool.js";

export const BOARD = "nucleo-f446re";

const here = (name) => new URL(name, import.meta.url);

async function bytes(name) {
  const answer = await fetch(here(name));
  if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
  return answer.arrayBuffer();
}

class WorkerLink extends Link {
  constructor() {
    super();
    this.waiting = new Map();
    this.asked = 0;
    // Compiled once for all workers.
    this.compiled = bytes("zwidth.wasm").then((code) => WebAssembly.compile(code));
    this.image = bytes(`${BOARD}.elf`).then((buffer) => new Uint8Array(buffer));
    this.pool = new Pool(this.compiled, here("study.js"));
  }

  // Starts a board on that device in place of the present one. If it fails it throws the error, and the present board
  // stays. The same happens if another board is wanted in the meantime; `isWanted` tells whether this one still is.
  async start(scene, core, isWanted = () => true) {
    const [compiled, elf] = await Promise.all([this.compiled, this.image]);
    const worker = new Worker(here("board.js"), { type: "module" });
    const hello = new Promise((resolve, reject) => {
      worker.onerror = (event) => reject(new Error(event.message || "the worker of the board does not start"));
      worker.onmessage = ({ data }) => data.failed ? reject(new Error(data.failed)) : resolve(data);
    });
    worker.postMessage({ do: "start", compiled, elf, board: BOARD, core, ...scene });
    try {
      const first = await hello;
      if (!isWanted()) throw new Error("another board is wanted");
      this.end("another board has come");
      Object.assign(this, { worker, scene, core });
      worker.onmessage = ({ data }) => this.hear(data);
      worker.onerror = ({ message }) => this.lose(message);
      this.tell("fresh");
      this.receive(first);
    } catch (error) {
      worker.terminate();
      throw error;
    }
  }

  hear(data) {
    if (typeof data === "string" || data instanceof ArrayBuffer) this.receive(data);
    else if (data.predict) this.predict(data.predict);
    else if (data.failed) this.lose(data.failed);
    else if ("speed" in data) this.tell("speed", data.speed);
    else if ("rows" in data) {
      this.waiting.get(data.id)?.resolve(data.rows);
      this.waiting.delete(data.id);
    }
  }

  // Rejects all requests for rows of this board.
  end(why) {
    this.worker?.terminate();
    this.worker = null;
    for (const { reject } of this.waiting.values()) reject(new Error(why));
    this.waiting.clear();
  }

  lose(why) {
    this.end(`the board has ended: ${why}`);
    this.tell("lost", `The virtual board has ended: ${why}`);
  }

  get connected() { return !!this.worker; }

  send(message) {
    this.worker?.postMessage({ do: "say", message: JSON.stringify(message) });
    return this.connected;
  }

  // Tells the worker whether the page is hidden.
  hide(value) { this.worker?.postMessage({ do: "hidden", value }); }

  rows(from, rows) {
    if (!this.worker) return Promise.reject(new Error("no board"));
    const id = ++this.asked;
    this.worker.postMessage({ do: "rows", from, rows, id });
    return new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }

  async predict(question) {
    const scene = this.scene;
    try {
      const { type, predicted } = await this.pool.ask({ ask: "predict", ...scene, board: BOARD, ...question }, "predict");
      if (scene === this.scene) this.tell(type, { predicted });
    } catch (error) {
      if (scene === this.scene) this.tell("predicted", { predicted: { ...question, points: [], envelope: [], error: error.message } });
    }
  }
}

export const link = new WorkerLink();
import("./web.js");
