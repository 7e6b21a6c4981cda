// State of the recipe: the text of the last answer, and the edits since.

const PARTS = /[A-Za-z_][A-Za-z_0-9-]*|\[\d+\]/g;
const KEPT = "nacre-studio";
const MOST_KEPT = 200;
const PAUSE_MS = 700;

export function split(path) {
  return (path.match(PARTS) ?? []).map((part) => (part[0] === "[" ? Number(part.slice(1, -1)) : part));
}

export function valueAt(data, path) {
  return split(path).reduce((holder, key) => holder?.[key], data);
}

export class Recipe {
  constructor() {
    Object.assign(this, { name: "", text: "", data: null, version: "", saved: "", edits: [], sent: new Map(), count: 0 });
    this.forget();
  }

  forget() {
    this.past = [];     // the steps: text and action
    this.at = -1;
    this.lastStep = 0;
    this.action = "Opened";
    this.group = this.lastGroup = "";   // consecutive changes of one number form one step
  }

  open({ name, text, version }) {
    Object.assign(this, { name, text, version, saved: text, data: null, edits: [] });
    this.sent.clear();
    this.forget();
    this.step(true);
  }

  // Apply an edit here and queue it for the server.
  change(edit) {
    this.count += 1;
    this.group = edit.op === "set" ? edit.path : String(this.count);
    this.action = inWords(edit);
    const last = this.edits.at(-1);
    if (last && edit.op === "set" && last.op === "set" && last.path === edit.path) this.edits.pop();
    this.edits.push({ ...edit, id: this.count });
    if (this.data) apply(this.data, edit);
  }

  type(text) {
    this.group = "text";
    this.action = "Edited as TOML";
    this.text = text;
    this.edits = [];
    this.sent.clear();
  }

  question(seq) {
    this.sent.set(seq, this.count);
    return { name: this.name, text: this.text, edits: this.edits };
  }

  // Take the server's text; edits after the request remain queued.
  settle(answer, isNewest) {
    const until = this.sent.get(answer.seq);
    for (const seq of this.sent.keys()) if (seq < answer.seq) this.sent.delete(seq);
    if (until === undefined) return false;
    this.edits = this.edits.filter((edit) => edit.id > until);
    if (answer.text !== undefined && answer.text !== null) this.text = answer.text;
    if (answer.data && isNewest) this.data = answer.data;
    return true;
  }

  step(isApart = false) {
    if (this.past[this.at]?.text === this.text) return;
    const now = performance.now();
    const joins = !isApart && this.group === this.lastGroup && now - this.lastStep < PAUSE_MS && this.at > 0;
    this.lastStep = now;
    this.lastGroup = this.group;
    this.past.length = this.at + 1;
    const made = { text: this.text, action: this.action };
    if (joins) this.past[this.at] = made;
    else this.at = this.past.push(made) - 1;
    if (this.past.length > MOST_KEPT) {
      this.past.shift();
      this.at -= 1;
    }
  }

  move(by) {
    const next = this.past[this.at + by];
    if (next === undefined) return false;
    this.at += by;
    this.type(next.text);
    this.lastStep = 0;
    return true;
  }

  get canUndo() { return this.at > 0; }
  get canRedo() { return this.at + 1 < this.past.length; }
  get isChanged() { return this.text !== this.saved || this.edits.length > 0; }

  // Store the recipe in this tab: it survives a reload and a restart of the server.
  store() {
    const { name, text, version, saved, edits } = this;
    try {
      sessionStorage.setItem(KEPT, JSON.stringify({ name, text, version, saved, edits }));
    } catch { /* storage is full or forbidden */ }
  }

  recall() {
    try {
      const saved = JSON.parse(sessionStorage.getItem(KEPT) ?? "null");
      if (!saved?.name) return false;
      Object.assign(this, saved, { edits: [] });
      this.step(true);
      for (const edit of saved.edits) this.change(edit);
      return true;
    } catch {
      return false;
    }
  }
}

function inWords({ op, path, value, index }) {
  if (op === "set") return `${path} = ${typeof value === "object" ? "…" : value}`;
  if (op === "insert") return `${path}: added one as number ${index + 1}`;
  return op === "remove" ? `${path} taken out` : `${path}: moved`;
}

function apply(data, { op, path, value, index, from, to }) {
  const keys = split(path);
  const last = keys.pop();
  let holder = data;
  for (const key of keys) holder = holder?.[key] ?? (holder[key] = {});
  if (op === "set") holder[last] = structuredClone(value);
  else if (op === "remove") Array.isArray(holder) ? holder.splice(last, 1) : delete holder[last];
  else if (op === "insert") (holder[last] ??= []).splice(index, 0, structuredClone(value));
  else if (op === "move") holder[last].splice(to, 0, ...holder[last].splice(from, 1));
}
