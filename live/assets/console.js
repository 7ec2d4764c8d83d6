// Log and console. All commands of the board's console work here.
const KEPT = 800;

export class Console {
  constructor(list, form, input, send) {
    Object.assign(this, { list, past: [], place: 0, follows: true, tall: 0 });
    // The list does not scroll if a person has scrolled up. It scrolls to the end after its height has shrunk, for
    // example by a message above it.
    list.onscroll = () => {
      if (list.clientHeight === this.tall) this.follows = list.scrollHeight - list.scrollTop - this.tall < 30;
    };
    new ResizeObserver(() => {
      this.tall = list.clientHeight;
      this.follow();
    }).observe(list);
    form.onsubmit = (event) => {
      event.preventDefault();
      const line = input.value.trim();
      if (!line) return;
      this.past.push(line);
      this.place = this.past.length;
      send(line);
      input.value = "";
    };
    input.onkeydown = (event) => {
      const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
      if (!step) return;
      this.place = Math.min(Math.max(this.place + step, 0), this.past.length);
      input.value = this.past[this.place] ?? "";
      event.preventDefault();
    };
  }

  add(lines) {
    if (!lines.length) return;
    for (const { from, text } of lines) {
      const item = document.createElement("li");
      item.className = text.startsWith("error") ? "error" : from;
      item.textContent = text;
      this.list.append(item);
    }
    while (this.list.childElementCount > KEPT) this.list.firstElementChild.remove();
    this.follow();
  }

  follow() { if (this.follows) this.list.scrollTop = this.list.scrollHeight; }

  clear() {
    this.list.replaceChildren();
    this.follows = true;
  }
}
