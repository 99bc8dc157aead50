// The table of the vehicles: what is known of each, signals as further columns, in the order that is wanted.
import { hull } from "./colours.js";
import { make, number, write } from "./dom.js";

const EVERY_MS = 250;
const SORT_MS = 1000;
const [NUMBER, ERROR, STATE] = [0, 1, 5];
const HEADS = ["name", "position error", "speed", "depth", "oldest data", "state"];

export class VehicleTable {
  constructor(setup, { onVehicle, onColumns, latest }) {
    this.setup = setup;
    this.handlers = { onVehicle, onColumns, latest };
    this.chosen = 0;
    this.columns = []; // names of signals
    this.drawn = this.sorted = 0;
    this.by = setup.crowd ? ERROR : NUMBER;
    this.down = this.by === ERROR;
    this.rows = Array.from({ length: setup.vehicles }, (_, k) => this.row(k + 1));
    this.head = make("tr");
    this.body = make("tbody", {}, ...this.rows.map((row) => row.el));
    const table = make("table", { class: setup.moored ? "fleet-moored" : setup.guided ? "" : "fleet-free" }, make("thead", {}, this.head), this.body);
    const add = make("input", {
      class: "fleet-signal", placeholder: "add a signal as a column ...", ariaLabel: "Signal to add as a column",
      onchange: () => {
        const name = add.value.trim();
        add.value = "";
        if (name && !this.columns.includes(name)) this.setColumns([...this.columns, name]);
      },
    });
    add.setAttribute("list", "fleet-signals");
    this.el = make("div", {}, make("div", { class: "fleet-scroll", tabIndex: 0 }, table), add);
    this.incoming = new Map();
    setup.links.forEach(([src, dst], k) => {
      if (!this.incoming.has(dst)) this.incoming.set(dst, []);
      this.incoming.get(dst).push([src, k]);
    });
    this.writeHead();
  }

  writeHead() {
    const sorting = (text, by) => {
      const sorted = this.by === by;
      const button = make("button", { type: "button", class: "fleet-sort", onclick: () => this.sortBy(by) }, `${text}${sorted ? (this.down ? " ▾" : " ▴") : ""}`);
      const head = make("th", { scope: "col" }, button);
      if (sorted) head.setAttribute("aria-sort", this.down ? "descending" : "ascending");
      return head;
    };
    const more = this.columns.map((name) => {
      const head = sorting(name, name);
      const remove = make("button", { type: "button", class: "fleet-sort", ariaLabel: `Remove the column ${name}`, onclick: () => this.setColumns(this.columns.filter((one) => one !== name)) }, "✕");
      head.append(remove);
      return head;
    });
    const [state, ...rest] = HEADS.map(sorting).reverse();
    this.head.replaceChildren(...rest.reverse(), ...more, state);
  }

  setColumns(names) {
    this.columns = names;
    if (!names.includes(this.by) && typeof this.by === "string") this.by = NUMBER;
    for (const row of this.rows) {
      row.more.forEach((cell) => cell.remove());
      row.more = names.map(() => make("td"));
      row.cells[STATE - 1].before(...row.more);
    }
    this.writeHead();
    this.drawn = this.sorted = 0;
    this.handlers.onColumns(names);
  }

  // The server refused the last one.
  forget(name) {
    if (this.columns.includes(name)) this.setColumns(this.columns.filter((one) => one !== name));
  }

  sortBy(by) {
    this.down = this.by === by ? !this.down : by !== NUMBER && by !== STATE;
    this.by = by;
    this.drawn = this.sorted = 0;
    this.writeHead();
    if (this.now) this.frame(this.now, true);
  }

  row(i) {
    const cells = Array.from({ length: STATE }, () => make("td"));
    const leads = this.setup.leaders.includes(i);
    const name = make(
      "button",
      { class: "fleet-name", type: "button", onclick: () => this.handlers.onVehicle(i), title: leads ? "knows the reference" : "" },
      make("span", { class: "fleet-dot", style: `background:${hull(i)}` }),
      `${this.setup.names[i - 1]}${leads ? " ★" : ""}`,
    );
    return { i, el: make("tr", {}, make("td", {}, name), ...cells), cells, more: [], values: [i] };
  }

  // The oldest data that a vehicle has of a neighbour: its age, and of whom.
  oldest(i, ages) {
    const heard = (this.incoming.get(i) ?? []).map(([src, link]) => [ages[link] ?? Infinity, src]);
    return heard.length ? heard.reduce((a, b) => (b[0] > a[0] ? b : a)) : [null, 0];
  }

  frame(frame, now = false) {
    this.now = frame;
    const at = performance.now();
    if (!now && at - this.drawn < EVERY_MS && !frame.clock.paused) return;
    this.drawn = at;
    const places = new Map(frame.uuv.map((row) => [row[0], row]));
    for (const row of this.rows) {
      const { i, cells } = row;
      const place = places.get(i);
      const state = frame.states[i] ?? "";
      const [age, of] = this.oldest(i, frame.ages);
      const error = frame.errors[i - 1];
      row.values = [i, error, place?.[6], place?.[3], age, state];
      write(cells[0], number(error, 2, "m"));
      write(cells[1], number(place?.[6], 2, "m/s"));
      write(cells[2], number(place?.[3], 1, "m"));
      write(cells[3], age == null ? "-" : `${age === Infinity ? `before ${frame.since.toFixed(1)} s` : `${age.toFixed(1)} s`}, of ${this.setup.names[of - 1]}`);
      write(cells[4], state);
      row.signals = Object.fromEntries(this.columns.map((name) => [name, this.handlers.latest(name, i)]));
      row.more.forEach((cell, k) => write(cell, shown(row.signals[this.columns[k]])));
      row.el.className = `${state ? "ill" : ""} ${this.chosen === i ? "chosen" : ""}`;
    }
    this.sort(at);
  }

  sort(at) {
    if (at - this.sorted < SORT_MS || (this.sorted && this.body.contains(document.activeElement))) return;
    this.sorted = at;
    const value = (row) => (typeof this.by === "string" ? row.signals?.[this.by] : row.values[this.by]);
    const compared = (a, b) => {
      const [x, y] = [value(a), value(b)];
      if (x == null || y == null) return (x == null) - (y == null) || a.i - b.i; // what is not known comes last
      const order = typeof x === "string" ? y.localeCompare(x) : x - y;
      return (this.down ? -order : order) || a.i - b.i;
    };
    const ordered = [...this.rows].sort(compared);
    if (ordered.every((row, k) => this.body.children[k] === row.el)) return;
    this.body.replaceChildren(...ordered.map((row) => row.el));
  }

  choose(i) {
    this.chosen = this.chosen === i ? 0 : i;
    this.drawn = 0;
    return this.chosen;
  }
}

const shown = (value) => (value == null ? "-" : Number.isInteger(value) ? `${value}` : value.toPrecision(4));
