// Messages between the page and the board's side, whatever that side is.
export class Link extends EventTarget {
  // A received message: JSON with its type, or values to plot with their type in the head.
  receive(data) {
    if (typeof data === "string") {
      const message = JSON.parse(data);
      this.tell(message.type, message);
    } else {
      this.tell(["", "curves", "spectra", "phase"][new DataView(data).getUint32(0, true)], data);
    }
  }

  tell(name, detail) { this.dispatchEvent(new CustomEvent(name, { detail })); }

  on(name, what) { this.addEventListener(name, (event) => what(event.detail)); }

  // `stopped`: the count of stops that the page knows. After a further stop the command is refused.
  command(line, stopped) { return this.send({ type: "command", line, stopped }); }
}

// A server and its socket. After a loss the socket is opened again automatically; it never arms the board.
export class SocketLink extends Link {
  constructor(token) {
    super();
    this.token = encodeURIComponent(token);
    this.address = `ws://${location.host}/ws?token=${this.token}`;
    this.pause = 250;
    this.open();
  }

  open() {
    this.socket = new WebSocket(this.address);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => { this.pause = 250; this.tell("open"); };
    this.socket.onmessage = ({ data }) => this.receive(data);
    this.socket.onclose = () => {
      this.tell("lost", "Not connected to the server. If force is on, it goes off within 0.2 s by itself; use the wired stop.");
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, 4000);
    };
  }

  get connected() { return this.socket.readyState === WebSocket.OPEN; }

  send(message) {
    if (this.connected) this.socket.send(JSON.stringify(message));
    return this.connected;
  }

  // Rows as text of a table; throws an error.
  async rows(from, rows) {
    const answer = await fetch(`rows.csv?token=${this.token}&from=${from}&rows=${rows}`);
    const text = await answer.text();
    if (!answer.ok) throw new Error(text);
    return text;
  }
}
