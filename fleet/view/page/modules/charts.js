// Charts that scroll: the last minute of the formation errors, the ages, the losses, and of a signal that was chosen.
import { hull } from "./colours.js";
import { round } from "./geometry.js";
import { fitted, make, write } from "./dom.js";

const SPAN_S = 60;
const EVERY_MS = 200;
const [LEFT, RIGHT, TOP, BOTTOM] = [40, 8, 6, 18];

class Chart {
  constructor(title, unit, lines, { least = 0, most = 0 } = {}) {
    this.title = make("span", { class: "fleet-chart-title" }, title);
    this.unit = make("span", { class: "fleet-chart-unit" }, unit);
    this.head = make("div", { class: "fleet-chart-head" }, this.title, this.unit);
    this.canvas = make("canvas", { role: "img", ariaLabel: `${title} over the last minute` });
    this.el = make("figure", { class: "fleet-chart" }, this.head, this.canvas);
    this.lines = lines;
    this.least = least;
    this.most = most;
    this.sized = new ResizeObserver(() => this.resize());
    this.sized.observe(this.canvas);
  }

  resize() {
    Object.assign(this, fitted(this.canvas));
  }

  // `lines()` gives [[colour, [[t, value], ...]], ...].
  draw(now, spans) {
    const { g, width, height } = this;
    if (!g || !width) return;
    const lines = this.lines();
    const from = Math.max(0, now - SPAN_S);
    const values = lines.flatMap(([, points]) => points.filter(([t]) => t >= from).map(([, value]) => value));
    const finite = values.filter(Number.isFinite);
    let low = Math.min(this.least, ...finite);
    let high = Math.max(this.most, ...finite);
    if (high - low < 1e-9) high = low + 1;
    const step = round((high - low) / 3);
    low = Math.floor(low / step + 1e-9) * step;
    high = Math.ceil(high / step - 1e-9) * step;
    const x = (t) => LEFT + ((t - from) / SPAN_S) * (width - LEFT - RIGHT);
    const y = (value) => height - BOTTOM - ((value - low) / (high - low)) * (height - TOP - BOTTOM);
    g.clearRect(0, 0, width, height);
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = "rgba(255, 92, 108, 0.14)";
    for (const [begin, end] of spans) {
      if (end > from && begin < now) {
        const left = x(Math.max(begin, from));
        g.fillRect(left, TOP, x(Math.min(end, now)) - left, height - TOP - BOTTOM);
      }
    }
    g.strokeStyle = "rgba(140, 180, 215, 0.22)";
    g.fillStyle = "#b9cbdd";
    g.lineWidth = 1;
    g.textAlign = "right";
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    for (let value = low; value <= high + step / 2; value += step) {
      g.beginPath();
      g.moveTo(LEFT, y(value));
      g.lineTo(width - RIGHT, y(value));
      g.stroke();
      g.fillText(value.toFixed(Math.min(6, digits)), LEFT - 5, y(value) + 4);
    }
    g.textAlign = "center";
    for (let t = Math.ceil(from / 20) * 20; t <= from + SPAN_S; t += 20) {
      if (x(t) < width - 16) g.fillText(`${t} s`, x(t), height - 4);
    }
    g.textAlign = "left";
    g.save();
    g.beginPath();
    g.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 2);
    g.clip();
    g.lineWidth = lines.length > 8 ? 1 : 1.8;
    g.lineJoin = "round";
    for (const [colour, points] of lines) {
      g.strokeStyle = colour;
      g.beginPath();
      let pen = false;
      for (const [t, value] of points) {
        if (t < from || !Number.isFinite(value)) {
          pen = false;
          continue;
        }
        if (pen) g.lineTo(x(t), y(value));
        else g.moveTo(x(t), y(value));
        pen = true;
      }
      g.stroke();
    }
    g.restore();
  }
}

export class Charts {
  constructor(el, setup, choose) {
    this.setup = setup;
    this.samples = [];
    this.signals = new Map();
    this.spans = new Map(); // of faults, by id
    this.units = new Map(); // of the signals that there are, by name
    this.name = "";
    this.choose = choose;
    const each = (column) => () =>
      Array.from({ length: setup.vehicles }, (_, k) => [
        hull(k + 1),
        this.samples.map((sample) => [sample[0], sample[column][k] ?? NaN]),
      ]);
    this.chosen = new Chart("", "", () => [["#f5c04a", this.signals.get(this.name) ?? []]]);
    this.charts = [
      new Chart("Formation error", "m", each(1), { most: 0.1 }),
      new Chart("Age of information", "s", each(2), { most: 0.5 }),
      new Chart("Packets lost", "%", () => [
        ["#ffa94d", this.samples.map((sample) => [sample[0], 100 * sample[3]])],
      ], { most: 10 }),
      this.chosen,
    ];
    this.select = make("input", {
      class: "fleet-signal",
      placeholder: "choose a signal of the log ...",
      ariaLabel: "Signal to show",
      onchange: () => this.pick(this.select.value),
    });
    this.list = make("datalist", { id: `fleet-signals-${Math.random().toString(36).slice(2)}` });
    this.select.setAttribute("list", this.list.id);
    this.chosen.head.replaceChildren(this.select, this.chosen.unit, this.list);
    el.append(...this.charts.map((chart) => chart.el));
    this.drawn = 0;
  }

  // Signals to choose from: the unit of each, by its name.
  offer(units) {
    this.units = new Map(Object.entries(units));
    this.list.replaceChildren(...Object.keys(units).map((name) => make("option", { value: name })));
  }

  pick(name) {
    this.name = name;
    this.choose(name);
  }

  history(history) {
    this.samples = [...history.samples];
    this.signals = new Map(Object.entries(history.signals ?? {}));
    this.now = this.samples.at(-1)?.[0] ?? 0;
    this.spans = new Map(this.setup.marks.map((fault) => [fault.id, [fault.from_s, fault.to_s]]));
    this.drawn = 0;
  }

  frame(frame) {
    const last = this.samples.at(-1)?.[0] ?? -1;
    this.samples.push(...frame.samples.filter((sample) => sample[0] > last));
    while (this.samples.length && this.samples[0][0] < frame.t - SPAN_S - 1) this.samples.shift();
    for (const [name, values] of Object.entries(frame.signals ?? {})) {
      const known = this.signals.get(name) ?? [];
      const end = known.at(-1)?.[0] ?? -1;
      known.push(...values.filter(([t]) => t > end));
      while (known.length && known[0][0] < frame.t - SPAN_S - 1) known.shift();
      this.signals.set(name, known);
    }
    this.mark(frame);
    this.now = frame.t;
    const at = performance.now();
    if (at - this.drawn < EVERY_MS) return;
    this.drawn = at;
    this.draw();
  }

  // When faults lasted. One that was healed ended when it left the list, earlier than it said.
  mark({ faults, t }) {
    const listed = new Set(faults.map(({ id }) => id));
    for (const [id, span] of this.spans) {
      if (!listed.has(id) && span[0] <= t && t < span[1]) span[1] = t;
    }
    for (const { id, from_s, to_s } of faults) this.spans.set(id, [from_s, to_s]);
  }

  draw() {
    for (const chart of this.charts) chart.draw(this.now, this.spans.values());
    const values = this.signals.get(this.name);
    const value = values?.at(-1)?.[1];
    const now = value == null ? "not a finite number" : `${value.toPrecision(4)} ${this.units.get(this.name) ?? ""}`;
    write(this.chosen.unit, values?.length ? `now ${now}`.trimEnd() : "");
  }

  end() {
    for (const chart of this.charts) chart.sized.disconnect();
  }
}
