// The form of a recipe; names, meanings, units, ranges and defaults come from the server.

const WIDEST_SLIDER = 1000;     // longer ranges are reduced to a part around the value
const STEPS = 500;

const el = (tag, props = {}, ...inside) => {
  const made = Object.assign(document.createElement(tag), props);
  made.append(...inside.filter((item) => item !== null && item !== undefined));
  return made;
};
const words = (name) => {
  const stem = name.replace(/_(nm|um|mm|deg)$/, "").replace(/_per_um2$/, "").replaceAll("_", " ");
  return stem.length < 3 ? stem : stem[0].toUpperCase() + stem.slice(1);
};
const unitOf = (name, key) => (/_(nm|um|mm)$/.exec(name)?.[1] ?? (key.unit === "degrees" ? "°" : key.unit ?? "")).replace("um", "µm").replace(/^1\/(.+)\^2$/, "$1⁻²");
const short = (x) => String(Number(x.toPrecision(7)));
const isTable = (x) => x !== null && typeof x === "object" && !Array.isArray(x);

export class Form {
  // `change(edit)` receives every edit; `search(text)` returns names of materials.
  constructor(root, help, { change, search }) {
    Object.assign(this, { root, help, change, search, model: null, shape: "", fields: new Map(), open: new Set() });
    this.found = document.getElementById("found");
    for (const event of ["focusin", "pointerover"]) {
      root.addEventListener(event, ({ target }) => this.explain(target.closest?.("[data-path]")));
    }
  }

  explain(row) {
    if (!row) return;
    this.help.replaceChildren(el("b", { textContent: row.dataset.path }), ` – ${row.dataset.meaning}`);
  }

  // Show a recipe's data; the layout changes only with its keys and entries.
  show(model, data) {
    const shape = JSON.stringify(data, (key, value) => (typeof value === "number" ? 0 : typeof value === "string" ? "" : value));
    if (model === this.model && shape === this.shape) {
      for (const [path, field] of this.fields) field(path);
      return;
    }
    Object.assign(this, { model, shape, fields: new Map() });
    const focus = document.activeElement?.closest?.("#form") ? document.activeElement.id : "";
    const scroll = this.root.scrollTop;
    this.root.replaceChildren(this.table(model.tables[model.root], data, ""));
    this.root.scrollTop = scroll;
    if (focus) document.getElementById(focus)?.focus();
  }

  // Show a message instead of a recipe.
  clear(line) {
    Object.assign(this, { model: null, shape: "", fields: new Map() });
    this.root.replaceChildren(el("p", { className: "quiet", textContent: line }));
  }

  read = () => undefined;       // (path) => value; set by the page

  table(table, data, path) {
    const set = el("fieldset"), unset = [];
    set.setAttribute("aria-label", path || "recipe");
    for (const key of table.keys) {
      const name = [key.name, ...Object.keys(key.spellings)].find((name) => data?.[name] !== undefined) ?? key.name;
      const value = data?.[name], place = path ? `${path}.${name}` : name;
      if (value === undefined && key.kind === "tables") set.append(this.list(key, [], place));
      else if (value === undefined) unset.push(this.unset(key, place, data, path));
      else set.append(this.given(key, value, place, key.spellings[name] ?? 1));
    }
    const optional = unset.filter(Boolean);
    if (optional.length) {
      const more = el("details", { open: this.open.has(path) }, el("summary", { textContent: `${optional.length} more, with default values` }), ...optional);
      more.addEventListener("toggle", () => (more.open ? this.open.add(path) : this.open.delete(path)));
      set.append(more);
    }
    return set;
  }

  given(key, value, path, factor) {
    if (key.kind === "tables" && Array.isArray(value)) return this.list(key, value, path);
    if (typeof value === "number") return this.number(key, path, factor, false);
    if (typeof value === "boolean") return this.tick(key, path);
    if (key.kind === "choice") return this.choice(key, path);
    if (typeof value === "string") return this.words(key, path);
    if (Array.isArray(value) && value.length && value.every((x) => typeof x === "number")) {
      return el("div", {}, ...value.map((_, i) => this.number(key, `${path}[${i}]`, factor, false, `${words(key.name)} ${i + 1}`)));
    }
    if (isTable(value)) return this.inner(key, value, path);
    return this.row(key, path, el("span", { className: "wide quiet", textContent: "edit this as TOML" }));
  }

  inner(key, value, path) {
    const table = this.model.tables[key.tables[0]];
    const remove = key.is_required ? null : this.button("✕", `Remove ${words(key.name)}`, () => this.change({ op: "remove", path }));
    // a material given by numbers can be replaced by a named one
    const named = key.kind === "material" ? this.button("by name", `Choose ${words(key.name)} by name`, () => this.change({ op: "set", path, value: "SiO2" })) : null;
    const head = el("div", { className: "head" }, el("span", { className: "name", textContent: words(key.name) }), named, remove);
    const box = el("div", { className: "table" }, head);
    if (table && key.kind !== "material" && Object.keys(value).every((name) => table.keys.some((k) => k.name === name || name in k.spellings))) {
      box.append(this.table(table, value, path));
    } else {
      for (const [name, part] of Object.entries(value)) {
        const own = { name, meaning: `${key.meaning}: ${name}`, value: "", unit: "", spellings: {}, tables: [], kind: "other", limits: {} };
        box.append(this.given(own, part, `${path}.${name}`, 1));
      }
    }
    return box;
  }

  list(key, entries, path) {
    const table = this.model.tables[key.tables[0]], one = words(key.name).replace(/s$/, "").replace(/^Strata$/, "Stratum");
    const box = el("div", { className: "table" }, el("div", { className: "head" }, el("span", { className: "name", textContent: words(key.name) })));
    entries.forEach((entry, i) => {
      const about = isTable(entry) && typeof entry.material === "string" ? ` · ${entry.material}` : "";
      const up = this.button("↑", `Move ${one} ${i + 1} up`, () => this.change({ op: "move", path, from: i, to: i - 1 }));
      const down = this.button("↓", `Move ${one} ${i + 1} down`, () => this.change({ op: "move", path, from: i, to: i + 1 }));
      up.disabled = i === 0;
      down.disabled = i === entries.length - 1;
      const copy = this.button("+", `Add a copy of ${one} ${i + 1}`, () => this.change({ op: "insert", path, index: i + 1, value: this.read(`${path}[${i}]`) }));
      const remove = this.button("✕", `Remove ${one} ${i + 1}`, () => this.change({ op: "remove", path: `${path}[${i}]` }));
      const head = el("div", { className: "head" }, el("span", { className: "name", textContent: `${one} ${i + 1}${about}` }), up, down, copy, remove);
      box.append(el("div", { className: "entry" }, head, this.table(table, entry, `${path}[${i}]`)));
    });
    const add = el("button", { type: "button", className: "add", textContent: `Add ${one.toLowerCase()}`, disabled: !key.template });
    add.dataset.add = path;
    add.addEventListener("click", () => this.change({ op: "insert", path, index: entries.length, value: entries.length ? this.read(`${path}[${entries.length - 1}]`) : key.template }));
    box.append(add);
    return box;
  }

  unset(key, path, data, holder) {
    if (key.kind === "table" && key.template) {
      const add = el("button", { type: "button", className: "add", textContent: `Add ${words(key.name).toLowerCase()}` });
      add.addEventListener("click", () => this.change({ op: "set", path, value: key.template }));
      return this.row(key, path, el("span", { className: "wide" }, add));
    }
    const kind = { number: () => this.number(key, path, 1, true), bool: () => this.tick(key, path), choice: () => this.choice(key, path),
      text: () => this.words(key, path), material: () => this.words(key, path) }[key.kind];
    return kind ? kind() : null;
  }

  row(key, path, ...inside) {
    const id = `f-${path}`;
    const label = el("label", { htmlFor: id, textContent: words(key.name) });
    const row = el("div", { className: "row" }, label, ...inside);
    const allowed = [key.value, key.unit].filter(Boolean).join(", ");
    row.dataset.path = path;
    row.dataset.meaning = `${key.meaning}${allowed ? ` (${allowed})` : ""}${key.default !== null && key.default !== undefined ? `; default: ${JSON.stringify(key.default)}` : ""}`;
    return row;
  }

  set(path, value) { this.change({ op: "set", path, value }); }

  number(key, path, factor, isUnset, name) {
    const limits = key.limits ?? {}, low = (limits.ge ?? limits.gt ?? -Infinity) / factor, high = (limits.le ?? limits.lt ?? Infinity) / factor;
    const start = isUnset ? key.default : this.read(path);
    const whole = limits.whole ?? false;
    const exact = el("input", { type: "number", id: `f-${path}`, step: whole ? 1 : "any" });
    const slider = el("input", { type: "range", tabIndex: 0 });
    if (Number.isFinite(low)) exact.min = low;
    if (Number.isFinite(high)) exact.max = high;
    const span = (value) => {
      let [from, to] = [low, high];
      if (!(to - from <= WIDEST_SLIDER / factor)) {
        const reach = Math.max(Math.abs(value) * 2, whole ? 10 : path.endsWith("nm") ? 200 : 1);
        from = Math.max(low, value < 0 ? -reach : 0);
        to = Math.min(high, reach);
      }
      const step = whole ? 1 : 10 ** Math.floor(Math.log10((to - from) / STEPS));
      // a slider takes its minimum plus whole steps: start at a round number
      slider.min = Number((Math.floor(from / step + 1e-9) * step).toPrecision(12));
      slider.max = to;
      slider.step = step;
    };
    const put = () => {
      const value = this.read(path);
      if (typeof value !== "number") return;
      if (value < Number(slider.min) || value > Number(slider.max)) span(value);
      if (document.activeElement !== exact) exact.value = short(value);
      slider.value = value;
    };
    span(typeof start === "number" ? start : 0);
    slider.setAttribute("aria-label", `${name ?? words(key.name)}, ${path}`);
    slider.addEventListener("input", () => {
      let value = Math.max(low, Math.min(high, Number(slider.value)));
      if (limits.gt !== undefined && value <= low) value = low + Number(slider.step);
      if (limits.lt !== undefined && value >= high) value = high - Number(slider.step);
      exact.value = short(value);
      this.set(path, Number(short(value)));
    });
    slider.addEventListener("change", () => { span(Number(slider.value)); slider.value = exact.value; });
    exact.addEventListener("input", () => { if (exact.value !== "" && Number.isFinite(exact.valueAsNumber)) { this.set(path, exact.valueAsNumber); span(exact.valueAsNumber); slider.value = exact.value; } });
    exact.addEventListener("blur", put);
    const row = this.row(key, path, slider, exact, el("span", { className: "unit", textContent: unitOf(path.replace(/\[\d+\]$/, ""), key) }));
    if (name) row.firstChild.textContent = name;
    if (isUnset) {
      row.classList.add("unset");
      if (typeof key.default === "number") [exact.placeholder, slider.value] = [short(key.default), key.default];
    } else {
      this.fields.set(path, put);
      put();
    }
    return row;
  }

  tick(key, path) {
    const box = el("input", { type: "checkbox", id: `f-${path}`, checked: this.read(path) ?? key.default ?? false });
    box.addEventListener("change", () => this.set(path, box.checked));
    this.fields.set(path, () => { box.checked = this.read(path) ?? key.default ?? false; });
    return this.row(key, path, box);
  }

  choice(key, path) {
    const box = el("select", { id: `f-${path}`, className: "wide" });
    const value = this.read(path) ?? key.default;
    if (value === null || value === undefined) box.append(el("option", { value: "", textContent: "–" }));
    box.append(...key.choices.map((choice) => el("option", { value: choice, textContent: choice })));
    const put = () => { box.value = this.read(path) ?? key.default ?? ""; };
    put();
    box.addEventListener("change", () => (box.value === "" ? this.change({ op: "remove", path }) : this.set(path, box.value)));
    box.disabled = key.name === "family";
    this.fields.set(path, put);
    return this.row(key, path, box);
  }

  words(key, path) {
    const isMaterial = key.kind === "material", box = el("input", { type: "text", id: `f-${path}`, className: "wide", autocomplete: "off", spellcheck: false });
    const shown = () => this.read(path) ?? "";
    box.value = shown();
    if (key.default !== null && key.default !== undefined) box.placeholder = key.default;
    if (isMaterial) {
      box.setAttribute("list", "found");
      box.addEventListener("focus", () => this.appearance(box.value));
      box.addEventListener("input", () => this.appearance(box.value));
    }
    const give = () => {
      const text = box.value.trim();
      if (text === shown()) return;
      if (text === "") { if (!key.is_required) this.change({ op: "remove", path }); return; }
      this.set(path, isMaterial && Number.isFinite(Number(text)) ? { n: Number(text) } : text);
    };
    box.addEventListener("change", give);
    this.fields.set(path, () => { if (document.activeElement !== box) box.value = shown(); });
    return this.row(key, path, box);
  }

  appearance(text) {
    clearTimeout(this.timer);
    this.timer = setTimeout(async () => {
      const found = await this.search(text);
      this.found.replaceChildren(...found.map(({ name, title }) => el("option", { value: name, label: title === name ? name : `${name} – ${title}` })));
    }, 120);
  }

  button(text, label, act) {
    const made = el("button", { type: "button", textContent: text, title: label });
    made.setAttribute("aria-label", label);
    made.addEventListener("click", act);
    return made;
  }
}
