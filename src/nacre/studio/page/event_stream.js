// Event streams of the server: one JSON object a line.

import { request } from "./common.js";

export const session = crypto.randomUUID?.() ?? String(Math.random());    // of this page; the server runs one job of each type for it

// Pass each event to `onEvent`. Throws the errors of the server; returns if `signal` is aborted.
export async function listen(path, body, signal, onEvent) {
  const answer = await request(path, { method: "POST", body: JSON.stringify({ ...body, session }), headers: { "content-type": "application/json" }, signal });
  if (!answer.ok) throw new Error((await answer.json().catch(() => ({}))).error ?? `the server answered ${answer.status}`);
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "", isEnded = false;
  for (;;) {
    const { value, done } = await reader.read();
    if (done) break;
    const lines = (rest + value).split("\n");
    rest = lines.pop();
    for (const line of lines) {
      const event = JSON.parse(line);
      if (event.kind === "error") throw new Error(event.error);
      isEnded ||= event.kind === "done";
      if (!isEnded) onEvent(event);
    }
  }
  if (!isEnded && !signal.aborted) throw new Error("the server closed the connection");
}
