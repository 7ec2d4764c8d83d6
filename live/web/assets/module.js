// Imports that dependencies expect from generated bindings. The module never calls them.
const NOTHING = new Proxy({}, { get: () => new Proxy({}, { get: (_, name) => () => { throw new Error(`there is no ${String(name)}`); } }) });

// The compiled module, used by a worker: a question with its data goes in, JSON and bytes come out.
export class Module {
  static async of(compiled) {
    const { exports } = await WebAssembly.instantiate(compiled, NOTHING);
    return new Module(exports);
  }

  constructor(exports) { this.exports = exports; }

  // Returns the first answer, with the other answers in `bytes`. Bad input throws its one line.
  ask(question, ...more) {
    const given = [new TextEncoder().encode(JSON.stringify(question)), ...more];
    let count;
    try {
      for (const bytes of given) {
        const place = this.exports.zwidth_input(bytes.length);
        new Uint8Array(this.exports.memory.buffer, place, bytes.length).set(bytes);
      }
      count = this.exports.zwidth_ask();
    } catch (error) {
      throw Object.assign(new Error(`the program of this page ended: ${this.text(0) || error}`), { ended: true });
    }
    const answer = JSON.parse(this.text(0));
    if (answer.error !== undefined) throw new Error(answer.error);
    answer.bytes = Array.from({ length: count - 1 }, (_, n) => this.copy(n + 1));
    return answer;
  }

  copy(number) {
    const [place, length] = [this.exports.zwidth_answer_at(number), this.exports.zwidth_answer_length(number)];
    return new Uint8Array(this.exports.memory.buffer, place, length).slice();
  }

  text(number) { return new TextDecoder().decode(this.copy(number)); }
}
