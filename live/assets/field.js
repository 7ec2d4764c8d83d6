// A field and the setting behind it. It shows what is in force, or is marked as what it is instead: being typed, sent,
// refused, or waiting until the board allows it; the board's sentence stands below it.

// What a person has typed, with a decimal comma too; null: nothing, NaN: no number.
export function number(text) {
  const plain = text.trim().replace(",", ".");
  if (!plain) return null;
  return /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(plain) ? Number(plain) : NaN;
}

export class Field {
  // `command`: its name on the console. `awaits`: the refusals after which it waits; none: it is chosen from a list.
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

  // What was typed.
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

  // What has become of a command, and the number of the line that says so.
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

  // What the board says is in force, after so many lines: nothing new if the last command was answered later.
  show(value, after) {
    if (after < this.since) return;
    const changed = value !== this.inForce;
    this.inForce = value;
    if (changed && ["refused", "waits"].includes(this.state)) this.mark("");
    if (!this.state && value !== undefined) this.input.value = value;
  }

  // Out of the way of what is being done, and to be sent again: `instead` is in force until then.
  wait(instead, why) {
    [this.value, this.inForce, this.since] = [this.inForce, instead, Infinity];
    this.line = `${this.command()} ${instead}`;
    this.mark("waits", why);
    this.send(this.line);
  }

  again() { if (this.state === "waits") this.set(this.value); }

  // Waits no longer.
  giveUp() { if (this.state === "waits") this.mark("refused", this.said.textContent); }

  release() {
    this.since = 0;
    this.mark("");
    this.show(this.inForce);
  }

  // Another board.
  forget() {
    this.inForce = undefined;
    this.release();
  }
}
