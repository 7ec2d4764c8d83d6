// The socket: what the server says, and what it is told. It comes back by itself after a loss; it never arms.
export class Link extends EventTarget {
  constructor(token) {
    super();
    this.address = `ws://${location.host}/ws?token=${encodeURIComponent(token)}`;
    this.pause = 250;
    this.open();
  }

  open() {
    this.socket = new WebSocket(this.address);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => { this.pause = 250; this.tell("open"); };
    this.socket.onmessage = ({ data }) => {
      if (typeof data === "string") {
        const message = JSON.parse(data);
        this.tell(message.type, message);
      } else {
        this.tell(["", "curves", "spectra", "phase"][new DataView(data).getUint32(0, true)], data);
      }
    };
    this.socket.onclose = () => {
      this.tell("lost");
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, 4000);
    };
  }

  tell(name, detail) { this.dispatchEvent(new CustomEvent(name, { detail })); }

  on(name, what) { this.addEventListener(name, (event) => what(event.detail)); }

  get connected() { return this.socket.readyState === WebSocket.OPEN; }

  send(message) {
    if (this.connected) this.socket.send(JSON.stringify(message));
    return this.connected;
  }

  command(line) { return this.send({ type: "command", line }); }
}
