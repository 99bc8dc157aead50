// The bar with the clock: of a live run pause, step and speed; of a log the time line.
import { showCommand } from "./copy.js";
import { make, write } from "./dom.js";
import { verdict } from "./verdict.js";

const SPEEDS = [["as fast as it goes", null], ["0.2 x", 0.2], ["0.5 x", 0.5], ["1 x", 1], ["2 x", 2], ["5 x", 5]];
const RATES = [0.1, 0.25, 0.5, 1, 2, 5, 10];

export class Bar {
  constructor(el, setup, say, { onView, onLine }) {
    this.setup = setup;
    this.say = say;
    this.time = make("span", { class: "fleet-time" });
    this.rate = make("span", { class: "fleet-rate" });
    this.waiting = make("span", { class: "fleet-waiting", role: "status" });
    this.verdict = make("span", { class: "fleet-verdict", hidden: true });
    const title = make(
      "div",
      { class: "fleet-title" },
      make("h1", {}, setup.scenario),
      this.verdict,
      make("span", { class: "fleet-note" }, setup.title),
    );
    const clock = make("div", { class: "fleet-clock" }, this.time, this.rate, this.waiting);
    this.view = this.button("From above", onView, "t on the picture");
    const parts = setup.live ? this.live(onLine) : this.log();
    el.append(make("div", { class: "fleet-head" }, title, clock), make("div", { class: "fleet-tools" }, ...parts, this.view));
  }

  button(text, onclick, title = "") {
    return make("button", { type: "button", class: "fleet-button", onclick, title }, text);
  }

  live(onLine) {
    const { say } = this;
    if (!this.setup.may_act) return [make("span", { class: "fleet-badge" }, "watching only")];
    this.pause = this.button("Pause", () => say({ do: "clock", how: this.paused ? "resume" : "pause" }), "space");
    const speed = make(
      "select",
      { ariaLabel: "Speed of the run", class: "fleet-select", onchange: (event) => say({ do: "clock", how: "speed", value: SPEEDS[event.target.value][1] }) },
      make("option", { value: "", disabled: true, selected: true }, "Speed ..."),
      ...SPEEDS.map(([text], k) => make("option", { value: k }, text)),
    );
    this.acting = [
      this.pause,
      this.button("Step", () => say({ do: "clock", how: "step", value: 10 }), "ten ticks, then pause"),
      speed,
      this.button("Disturb ...", () => say({ do: "fleet" }), "a fault in words: partition, current, gust"),
      this.button("Cut with a line", onLine, "draw a line through the fleet: the two sides hear nothing of each other"),
      this.button("Heal all", () => say({ do: "heal", id: null })),
    ];
    return [
      ...this.acting.slice(0, 3),
      make("span", { class: "fleet-gap" }),
      ...this.acting.slice(3),
      this.button("Save as scenario", () => say({ do: "script" }), "the run with all that was injected, to be run again"),
    ];
  }

  log() {
    const { say, setup } = this;
    const end = setup.log_end_s;
    this.pause = this.button("Play", () => say({ do: "toggle" }), "space");
    this.slider = make("input", {
      type: "range", min: 0, max: end, step: 0.1, value: 0, ariaLabel: "Time in the log [s]", class: "fleet-slider",
      oninput: () => this.seek(),
    });
    this.marks = make("div", { class: "fleet-marks" });
    const rate = make(
      "select",
      { ariaLabel: "Rate", class: "fleet-select", onchange: (event) => say({ do: "rate", rate: Number(event.target.value) }) },
      ...RATES.map((value) => make("option", { value, selected: value === 1 }, `${value} x`)),
    );
    const from = this.button("Go on from here", () => showCommand(this.goOn(), "The run is made again up to this time, and goes on from there."), "shows the command");
    const what = this.button("What if", () => showCommand(this.whatIf(), "Agents hear what they heard, with another controller."), "shows the command");
    return [
      this.pause, rate, make("div", { class: "fleet-line" }, this.marks, this.slider),
      this.button("Next fault", () => say({ do: "next fault" })),
      this.button("Next loss", () => say({ do: "next loss" })),
      from, what,
    ];
  }

  // Where faults are on the time line.
  known({ faults }) {
    const end = this.setup.log_end_s;
    this.marks?.replaceChildren(...faults.map(({ what, from_s, to_s }) => {
      const [from, to] = [from_s / end, Math.min(1, to_s / end)];
      return make("span", { style: `left:${100 * from}%;width:${Math.max(0.3, 100 * (to - from))}%`, title: `${what}, ${from_s} to ${to_s} s` });
    }));
  }

  checks(checks) {
    const [kind, text] = verdict(checks);
    this.verdict.hidden = !text;
    this.verdict.className = `fleet-verdict ${kind}`;
    write(this.verdict, text);
  }

  // One jump at a time: the next when its picture has come.
  seek() {
    this.wanted = Number(this.slider.value);
    if (this.asked) return;
    this.asked = true;
    this.say({ do: "seek", at_s: this.wanted });
    this.wanted = null;
    setTimeout(() => {
      this.asked = false;
      if (this.wanted != null) this.seek();
    }, 150);
  }

  frame(frame) {
    const { clock } = frame;
    this.at = frame.t;
    this.paused = clock.paused;
    write(this.time, `t = ${frame.t.toFixed(1)} s`);
    const measured = this.setup.live && clock.rate ? `, ${clock.rate.toFixed(1)} x real time` : "";
    const state = clock.text.includes("x real time") && measured ? measured.slice(2) : clock.text + measured;
    write(this.rate, `${this.setup.ends ? `of ${this.setup.end_s.toFixed(0)} s` : "until it is stopped"} · ${state}`);
    write(this.waiting, [clock.waiting, clock.note, frame.slow ? "drawing is slower than the run" : ""].filter(Boolean).join(" · "));
    if (this.pause) write(this.pause, this.setup.live ? (clock.paused ? "Resume" : "Pause") : clock.paused ? "Play" : "Pause");
    for (const control of this.acting ?? []) control.disabled = clock.over;
    if (this.slider && document.activeElement !== this.slider) this.slider.value = frame.t;
    else if (this.slider && !this.asked) this.slider.value = frame.t;
  }

  problem(text) {
    write(this.waiting, text);
  }

  goOn() {
    return `fleet run --from ${this.setup.log}@${this.at.toFixed(2)}s`;
  }

  whatIf() {
    return `fleet whatif ${this.setup.log} --agent ${this.chosen || 1} --controller bsmc`;
  }
}
