// Charts: of a live run the last minute, of a log the whole of it with a cursor. Formation errors, ages, losses, signals.
import { hull } from "./colours.js";
import { round } from "./geometry.js";
import { fitted, make, write } from "./dom.js";

const SPAN_S = 60;
const ON_AIR_S = 20; // a transmission of half a second is a few pixels long
const EVERY_MS = 200;
const [LEFT, RIGHT, TOP, BOTTOM] = [40, 8, 6, 18];
const ONE = "#f5c04a"; // a signal of one vehicle
const APART_PX = 1.6; // between steps of vehicles that have one value
const FEW = 12; // vehicles whose steps are drawn apart

class Chart {
  constructor(title, unit, lines, { least = 0, most = 0, onSeek = null } = {}) {
    this.title = make("span", { class: "fleet-chart-title" }, title);
    this.unit = make("span", { class: "fleet-chart-unit" }, unit);
    this.head = make("div", { class: "fleet-chart-head" }, this.title, this.unit);
    this.canvas = make("canvas", { role: "img", ariaLabel: title });
    this.el = make("figure", { class: "fleet-chart" }, this.head, this.canvas);
    this.lines = lines;
    this.least = least;
    this.most = most;
    if (onSeek) this.canvas.addEventListener("click", (event) => this.time && onSeek(this.time(event.offsetX)));
    this.sized = new ResizeObserver(() => this.resize());
    this.sized.observe(this.canvas);
  }

  resize() {
    Object.assign(this, fitted(this.canvas));
    this.shown?.();
  }

  // `lines()` gives [[colour, [[t, value], ...]], ...]; moments: [[t, text], ...]; cursor: a time, or null.
  draw({ from, span, now, cursor, spans, moments }) {
    this.shown = () => this.draw({ from, span, now, cursor, spans, moments });
    const { g, width, height } = this;
    if (!g || !width) return;
    const lines = this.lines();
    const [low, high, step] = this.range(lines, from);
    const x = (t) => LEFT + ((t - from) / span) * (width - LEFT - RIGHT);
    const y = (value) => height - BOTTOM - ((value - low) / (high - low)) * (height - TOP - BOTTOM);
    this.time = (px) => from + (Math.min(width - RIGHT, Math.max(LEFT, px)) - LEFT) / (width - LEFT - RIGHT) * span;
    g.clearRect(0, 0, width, height);
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = "rgba(255, 92, 108, 0.14)";
    const until = cursor == null ? now : from + span;
    for (const [begin, end] of spans) {
      if (end > from && begin < until) {
        const left = x(Math.max(begin, from));
        g.fillRect(left, TOP, Math.max(1, x(Math.min(end, until)) - left), height - TOP - BOTTOM);
      }
    }
    this.drawGrid({ low, high, step, from, span, x, y });
    g.save();
    g.beginPath();
    g.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 2);
    g.clip();
    for (const [t] of moments) this.drawUpright(x(t), "#ff7a87", [3, 3]);
    g.lineWidth = lines.length > 8 ? 1 : 1.8;
    g.lineJoin = "round";
    const apart = lines.length > 1 && lines.length <= FEW ? APART_PX : 0;
    lines.forEach(([colour, points], k) => this.drawLine(colour, points, from, x, y, apart * (k - (lines.length - 1) / 2)));
    if (cursor != null) this.drawUpright(x(cursor), "#ffffff", []);
    g.restore();
  }

  range(lines, from) {
    let [low, high] = [this.least, this.most];
    for (const [, points] of lines) {
      for (const [t, value] of points) {
        if (t < from || !Number.isFinite(value)) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (high - low < 1e-9) high = low + 1;
    const step = round((high - low) / 3);
    return [Math.floor(low / step + 1e-9) * step, Math.ceil(high / step - 1e-9) * step, step];
  }

  drawGrid({ low, high, step, from, span, x, y }) {
    const { g, width, height } = this;
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
    this.drawTimes(from, span, x);
  }

  drawTimes(from, span, x) {
    const { g, width, height } = this;
    g.fillStyle = "#b9cbdd";
    g.textAlign = "center";
    const every = Math.max(span / 3, (60 * span) / (width - LEFT - RIGHT));
    const tick = span === SPAN_S ? 20 : round(every);
    for (let t = Math.ceil(from / tick) * tick; t <= from + span; t += tick) {
      if (x(t) < width - 16) g.fillText(`${Number(t.toFixed(3))} s`, x(t), height - 4);
    }
    g.textAlign = "left";
  }

  drawUpright(x, colour, dash) {
    const { g, height } = this;
    g.strokeStyle = colour;
    g.lineWidth = 1.2;
    g.setLineDash(dash);
    g.beginPath();
    g.moveTo(x, TOP);
    g.lineTo(x, height - BOTTOM);
    g.stroke();
    g.setLineDash([]);
    g.lineWidth = this.lines.length > 8 ? 1 : 1.8;
  }

  // Whole numbers are states that hold until the next one: steps, of several vehicles side by side.
  drawLine(colour, points, from, x, y, aside) {
    const { g } = this;
    const steps = isWhole(points);
    const up = steps ? aside : 0;
    g.strokeStyle = colour;
    g.beginPath();
    let last = null;
    for (const [t, value] of points) {
      if (t < from || !Number.isFinite(value)) {
        last = null;
        continue;
      }
      if (last == null) g.moveTo(x(t), y(value) + up);
      else {
        if (steps) g.lineTo(x(t), y(last) + up);
        g.lineTo(x(t), y(value) + up);
      }
      last = value;
    }
    g.stroke();
  }
}

// A row for each modem, with what it transmitted lately: of a log, too, whose whole would be bars of less than a pixel.
class ChannelChart extends Chart {
  constructor({ names }) {
    super("On the air", `last ${ON_AIR_S} s`, () => []);
    this.names = names;
    this.transmissions = []; // [sender, begin, airtime]
  }

  range() {
    return [0, this.names.length, 1];
  }

  drawGrid({ from, span, x, y }) {
    const { g, names, height } = this;
    this.drawTimes(from, span, x);
    const tall = (height - TOP - BOTTOM) / names.length;
    const every = Math.ceil(11 / tall); // rows from one name to the next
    g.textAlign = "right";
    names.forEach((name, k) => {
      if (k % every === 0) g.fillText(name, LEFT - 5, y(names.length - k - 0.5) + 4, LEFT - 6);
      g.fillStyle = "rgba(140, 180, 215, 0.10)";
      if (k % 2 === 0) g.fillRect(LEFT, y(names.length - k), x(from + span) - LEFT, tall);
      g.fillStyle = "#b9cbdd";
    });
    g.textAlign = "left";
    for (const [src, begin, airtime] of this.transmissions) {
      const left = Math.max(LEFT, x(begin));
      const right = Math.min(x(from + span), Math.max(x(begin + airtime), x(begin) + 1));
      g.fillStyle = hull(src);
      if (right > left) g.fillRect(left, y(names.length - src + 0.9), right - left, 0.8 * tall);
    }
  }

  take(transmissions, now) {
    this.transmissions = [...this.transmissions, ...transmissions].filter(([, begin, airtime]) => begin + airtime > now - ON_AIR_S);
  }
}

export const isWhole = (points) =>
  points.some(([, value]) => value != null) && points.every(([, value]) => value == null || Number.isInteger(value));

export class Charts {
  constructor(el, setup, { onNames, onSeek }) {
    this.setup = setup;
    this.onNames = onNames;
    this.onSeek = setup.live ? null : onSeek;
    this.samples = [];
    this.signals = new Map(); // values of the last minute, by name
    this.whole = null; // of a log: its curves
    this.spans = []; // of faults
    this.moments = []; // at which checks failed
    this.units = new Map(); // of the signals that there are, by name
    this.fleet = new Map(); // unit and names of signals that vehicles have, by what they are called for all of them
    const each = (column) => () =>
      Array.from({ length: setup.vehicles }, (_, k) => [hull(k + 1), this.shown.map((sample) => [sample[0], sample[column][k]])]);
    const options = (more) => ({ ...more, onSeek: this.onSeek });
    this.channel = setup.acoustic ? new ChannelChart(setup) : null;
    this.list = make("datalist", { id: "fleet-signals" });
    this.picked = [...setup.charted, ""].map((name) => this.chooser(name, options({})));
    this.charts = [
      ...this.picked.slice(0, -1).map(({ chart }) => chart),
      ...(!setup.guided ? [] : [new Chart("Formation error", "m", each(1), options({ most: 0.1 }))]),
      new Chart("Age of information", "s", each(2), options({ most: 0.5 })),
      new Chart("Packets lost", "%", () => [["#ffa94d", this.shown.map((sample) => [sample[0], 100 * sample[3] + 1e-9])]], options({ most: 10 })),
      this.picked.at(-1).chart,
    ];
    this.all = [...this.charts.slice(0, -1), ...(this.channel ? [this.channel] : []), this.charts.at(-1)];
    el.append(...this.all.map((chart) => chart.el), this.list);
    this.drawn = 0;
    if (this.onSeek) for (const { head } of this.charts.slice(0, -1)) head.append(make("span", { class: "fleet-chart-unit fleet-reading" }, "reading the log ..."));
  }

  // The samples that the charts show.
  get shown() {
    return this.whole?.samples.length ? this.whole.samples : this.samples;
  }

  // A chart of a signal that can be chosen, of one vehicle or of all.
  chooser(name, options) {
    const picked = { name };
    const chart = new Chart("", "", () => this.linesOf(picked.name), options);
    const input = make("input", {
      class: "fleet-signal", placeholder: "choose a signal ...", value: name,
      ariaLabel: name ? `Signal to show instead of ${name}` : "Signal to show",
      onchange: () => {
        picked.name = input.value.trim();
        this.follow();
      },
    });
    input.setAttribute("list", this.list.id);
    chart.head.replaceChildren(input, chart.unit);
    chart.note = make("p", { class: "fleet-chart-note" });
    chart.el.append(chart.note);
    return Object.assign(picked, { chart, input });
  }

  linesOf(name) {
    const values = (one) => (this.shown === this.samples ? this.signals : new Map(Object.entries(this.whole.signals))).get(one) ?? [];
    const of = this.fleet.get(name);
    if (!of) return [[ONE, values(name)]];
    return Array.from({ length: this.setup.vehicles }, (_, k) => [hull(k + 1), values(ofVehicle(of[1], k + 1))]);
  }

  // Signals to choose from: the unit of each by its name, and those that vehicles have.
  offer({ units, fleet }) {
    this.units = new Map(Object.entries(units));
    this.fleet = new Map(Object.entries(fleet));
    const names = [...this.fleet.keys(), ...this.units.keys()];
    this.list.replaceChildren(...names.map((name) => make("option", { value: name })));
    this.follow();
  }

  follow() {
    const first = this.fleet.keys().next().value;
    for (const { name, chart } of this.picked) {
      chart.canvas.hidden = !name;
      chart.note.hidden = Boolean(name);
      write(chart.note, first ? `One more signal over time, such as ${first}.` : "One more signal over time.");
    }
    const names = this.picked.map(({ name }) => name).filter(Boolean);
    if (names.length || this.asked) this.onNames(names);
    this.asked = names.length > 0;
    this.drawn = 0;
  }

  // The last value of a signal of a vehicle, by its name for all of them.
  latest(name, i) {
    const of = this.fleet.get(name);
    return this.signals.get(of ? ofVehicle(of[1], i) : name)?.at(-1)?.[1];
  }

  history(history) {
    this.samples = [...history.samples];
    this.signals = new Map(Object.entries(history.signals ?? {}));
    this.now = this.samples.at(-1)?.[0] ?? 0;
    if (this.channel) this.channel.transmissions = history.on_air;
    this.drawn = 0;
  }

  setWhole(whole) {
    this.whole = whole;
    // A run that goes on from another begins later than 0.
    this.begin = whole.samples.find(([, errors]) => errors.some((error) => error != null))?.[0] ?? 0;
    document.querySelectorAll(".fleet-reading").forEach((note) => note.remove());
    this.drawn = 0;
    this.draw();
  }

  known({ faults }) {
    this.spans = faults.map(({ from_s, to_s }) => [from_s, to_s]);
  }

  checks({ rows }) {
    this.moments = rows.filter(({ at_s }) => at_s != null).map(({ at_s, check }) => [at_s, check]);
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
    this.now = frame.t;
    this.channel?.take(frame.on_air, frame.t);
    const at = performance.now();
    if (at - this.drawn < EVERY_MS) return;
    this.drawn = at;
    this.draw();
  }

  draw() {
    const { now, spans, moments } = this;
    this.channel?.draw({ from: Math.max(0, now - ON_AIR_S), span: ON_AIR_S, now, cursor: null, spans, moments: [] });
    if (this.onSeek && !this.whole) return; // the curves of a log are not read yet
    const all = this.shown !== this.samples;
    const from = all ? this.begin : Math.max(0, now - SPAN_S);
    const span = all ? Math.max(1e-3, this.setup.log_end_s - from) : SPAN_S;
    for (const chart of this.charts) chart.draw({ from, span, now, cursor: all ? now : null, spans, moments });
    for (const { name, chart } of this.picked) write(chart.unit, this.valueOf(name));
  }

  // Beside the name of a signal: its value now, or of a signal of all vehicles its unit.
  valueOf(name) {
    const of = this.fleet.get(name);
    if (of) return of[0] === "1" ? "" : of[0];
    const values = this.signals.get(name);
    if (!values?.length) return "";
    const value = values.at(-1)[1];
    return value == null ? "now not a finite number" : `now ${value.toPrecision(4)} ${this.units.get(name) ?? ""}`.trimEnd();
  }

  end() {
    for (const chart of this.all) chart.sized.disconnect();
  }
}

const ofVehicle = (name, i) => name.replace("uuv/*/", `uuv/${i}/`);
