// Answers of many lines: each a table of JSON, handed on as it comes.

import { reach } from "./common.js";

export const session = crypto.randomUUID?.() ?? String(Math.random());    // of this page: the server does one of a kind for it at a time

// Throws what the server says is wrong; ends early, without a word, where `signal` is aborted.
export async function listen(path, body, signal, hear) {
  const answer = await reach(path, { method: "POST", body: JSON.stringify({ ...body, session }), headers: { "content-type": "application/json" }, signal });
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
      if (!isEnded) hear(event);
    }
  }
  if (!isEnded && !signal.aborted) throw new Error("the server ended it");
}
