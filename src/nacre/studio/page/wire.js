// The socket: numbered questions, answers that never overtake, and a new socket when the old one is lost.

import { unpack } from "./unpack.js";

const FIRST_WAIT_MS = 300;
const LONGEST_WAIT_MS = 5000;

export class Wire {
  // `makeQuestion` is asked for the newest state whenever something may be sent, so nothing old is ever sent again
  constructor(makeQuestion, onAnswer, onState) {
    Object.assign(this, { makeQuestion, onAnswer, onState });
    this.seq = 0;
    this.heard = 0;
    this.asked = -Infinity;     // when, by the page's clock
    this.wait = FIRST_WAIT_MS;
    this.open();
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => document.hidden || this.hurry());
  }

  open() {
    clearTimeout(this.timer);
    const socket = new WebSocket(`ws://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.wait = FIRST_WAIT_MS;
      this.isRefused = false;
      this.onState("open");
      this.ask();
    };
    socket.onmessage = ({ data }) => {
      const answer = typeof data === "string" ? JSON.parse(data) : unpack(data);
      if (answer.seq < this.heard) return;
      this.heard = answer.seq;
      this.onAnswer(answer, answer.seq === this.seq);
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      if (!this.isRefused) this.onState("lost");
      this.knock(socket);
      this.timer = setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_WAIT_MS);
    };
  }

  // A socket does not tell whether nobody answered or a server did that knows this page's token no more.
  async knock(socket) {
    this.isRefused = await fetch("favicon.ico").then(({ status }) => status === 403, () => false);
    if (this.isRefused && this.socket === socket) this.onState("refused");
  }

  hurry() {
    if (this.socket.readyState === WebSocket.CLOSED) this.open();
  }

  // Send what there is now, under a new number. Without a connection it is sent when there is one again.
  ask() {
    if (this.socket.readyState !== WebSocket.OPEN) return 0;
    const question = this.makeQuestion(this.seq + 1);
    if (!question) return 0;
    this.seq += 1;
    this.asked = performance.now();
    this.socket.send(JSON.stringify({ seq: this.seq, ...question }));
    this.onState("asked");
    return this.seq;
  }
}
