// The WebSocket: numbered requests, answers in order, and reconnection.

import { unpack } from "./unpack.js";

const FIRST_WAIT_MS = 300;
const LONGEST_WAIT_MS = 5000;

export class Socket {
  // `makeQuestion` returns the newest state whenever a request is sent
  constructor(makeQuestion, onAnswer, onState) {
    Object.assign(this, { makeQuestion, onAnswer, onState });
    this.seq = 0;
    this.heard = 0;
    this.asked = -Infinity;     // time of the last request
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

  // Detect whether the server is absent or refuses this page's token.
  async knock(socket) {
    this.isRefused = await fetch("favicon.ico").then(({ status }) => status === 403, () => false);
    if (this.isRefused && this.socket === socket) this.onState("refused");
  }

  hurry() {
    if (this.socket.readyState === WebSocket.CLOSED) this.open();
  }

  // Send the current state with a new number; without a connection it is sent after reconnection.
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
