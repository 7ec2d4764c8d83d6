// A field and its setting. It shows the value in force, or is marked: being typed, sent, refused, or waiting until the
// board allows the value. The board's reply is shown below it.

// The number that a person has typed, also with a decimal comma; null: empty, NaN: not a number.
export function number(text) {
  const plain = text.trim().replace(",", ".");
  if (!plain) return null;
  return /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(plain) ? Number(plain) : NaN;
}

export class Field {
  // `command`: its name on the console. `awaits`: refusals after which the value waits; none: the value is chosen from
  // a list.
  constructor(input, send, command, awaits) {
    Object.assign(this, { input, send, command, awaits, state: "", inForce: undefined, since: 0, value: null, line: "" });
    this.said = document.createElement("small");
    input.closest("label").after(this.said);
    this.mark("");
    input.oninput = () => this.mark("typed");
    input.onchange = () => this.take();
    input.onblur = () => { if (this.state === "typed") this.take(); };
    if (awaits) input.onkeydown = ({ key }) => { if (key === "Enter") input.blur(); };
  }

  mark(state, why = "") {
    this.state = this.input.dataset.state = state;
    this.said.textContent = why;
    this.said.hidden = !why;
  }

  // Takes the typed value.
  take() {
    const value = this.awaits ? number(this.input.value) : this.input.value;
    if (value === null) this.release();
    else if (Number.isNaN(value)) this.mark("refused", "allowed a number");
    else this.set(value);
  }

  set(value) {
    this.value = this.input.value = value;
    this.line = `${this.command()} ${value}`;
    this.mark("sent", this.state === "waits" ? this.said.textContent : "");
    if (!this.send(this.line)) this.mark("refused", "not connected");
  }

  // Handles the reply to a command, with the number of its line.
  hear(line, text, number) {
    if (line !== this.line || !["sent", "waits"].includes(this.state)) return;
    this.since = number;
    if (this.state === "waits") return;
    if (text.startsWith("ok")) {
      this.inForce = this.value;
      return this.mark("");
    }
    const why = text.replace(/^error: /, "");
    this.mark(this.awaits?.test(why) ? "waits" : "refused", why);
    if (!this.awaits) this.input.value = this.inForce;
  }

  // Shows the value in force as of line `after`. Older than the reply to the last command, the value is ignored.
  show(value, after) {
    if (after < this.since) return;
    const changed = value !== this.inForce;
    this.inForce = value;
    if (changed && ["refused", "waits"].includes(this.state)) this.mark("");
    if (!this.state && value !== undefined) this.input.value = value;
  }

  // Sets the value aside, to be sent again later: `instead` is in force until then.
  wait(instead, why) {
    [this.value, this.inForce, this.since] = [this.inForce, instead, Infinity];
    this.line = `${this.command()} ${instead}`;
    this.mark("waits", why);
    this.send(this.line);
  }

  again() { if (this.state === "waits") this.set(this.value); }

  // Stops waiting.
  giveUp() { if (this.state === "waits") this.mark("refused", this.said.textContent); }

  release() {
    this.since = 0;
    this.mark("");
    this.show(this.inForce);
  }

  // Clears the field for another board.
  forget() {
    this.inForce = undefined;
    this.release();
  }
}
