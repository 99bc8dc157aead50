// What stands beside the picture: the vehicles in numbers, faults, checks, and the commands that had an effect.
import { LINKS, hull } from "./colours.js";
import { make, number, write } from "./dom.js";

const EVERY_MS = 250;
const COMMANDS = [["surge", "N"], ["pitch", "N m"], ["yaw", "N m"]];
const panel = (title, ...children) =>
  make("section", { class: "fleet-panel" }, make("h2", {}, title), ...children);

export class Panels {
  constructor(el, setup, { onVehicle, onLink, onHeal, onInject, latest }) {
    this.setup = setup;
    this.handlers = { onVehicle, onLink, onHeal, onInject, latest };
    this.chosen = 0;
    this.drawn = 0;
    this.rows = Array.from({ length: setup.vehicles }, (_, k) => this.row(k + 1));
    const head = ["UUV", "off place", "speed", "depth", "oldest news", "state"].map((text) => make("th", { scope: "col" }, text));
    const table = make(
      "table",
      {},
      make("thead", {}, make("tr", {}, ...head)),
      make("tbody", {}, ...this.rows.map((row) => row.el)),
    );
    this.detail = make("div", { class: "fleet-detail", hidden: true });
    this.faults = make("ul", { class: "fleet-faults" });
    this.checks = make("ul", { class: "fleet-checks" });
    this.commands = make("ul", { class: "fleet-commands" });
    this.commandPanel = panel("Commands behind what was done here", this.commands);
    this.commandPanel.hidden = true;
    const checks = panel("Checks", this.checks);
    this.checkTitle = checks.firstChild;
    el.append(
      panel("Vehicles", make("div", { class: "fleet-scroll", tabIndex: 0 }, table), this.detail),
      panel("Faults", this.faults),
      checks,
      this.commandPanel,
    );
    this.incoming = new Map();
    setup.links.forEach(([src, dst], k) => {
      if (!this.incoming.has(dst)) this.incoming.set(dst, []);
      this.incoming.get(dst).push([src, k]);
    });
    this.listed = "";
    this.writeFaults([], 0);
  }

  row(i) {
    const cells = Array.from({ length: 5 }, () => make("td"));
    const name = make(
      "button",
      { class: "fleet-name", type: "button", onclick: () => this.handlers.onVehicle(i) },
      make("span", { class: "fleet-dot", style: `background:${hull(i)}` }),
      `${i}${this.setup.leaders.includes(i) ? " ★" : ""}`,
    );
    name.title = this.setup.leaders.includes(i) ? "knows the reference" : "";
    return { el: make("tr", {}, make("td", {}, name), ...cells), cells };
  }

  frame(frame) {
    const at = performance.now();
    if (at - this.drawn < EVERY_MS && !frame.clock.paused) return;
    this.drawn = at;
    const places = new Map(frame.uuv.map((row) => [row[0], row]));
    this.rows.forEach(({ el, cells }, k) => {
      const i = k + 1;
      const place = places.get(i);
      const state = frame.states[i] ?? "";
      const heard = (this.incoming.get(i) ?? []).map(([src, link]) => [frame.ages[link], src]);
      const [age, of] = heard.length ? heard.reduce((a, b) => (b[0] > a[0] ? b : a)) : [null, 0];
      write(cells[0], number(frame.errors[k], 2, "m"));
      write(cells[1], number(place?.[6], 2, "m/s"));
      write(cells[2], number(place?.[3], 1, "m"));
      write(cells[3], age == null ? "-" : `${age.toFixed(1)} s, of ${of}`);
      write(cells[4], state);
      el.className = `${state ? "ill" : ""} ${this.chosen === i ? "chosen" : ""}`;
    });
    this.writeDetail(frame, places);
    this.writeFaults(frame.faults, frame.t);
  }

  choose(i) {
    this.chosen = this.chosen === i ? 0 : i;
    this.drawn = 0;
    this.detailOf = 0;
    return this.chosen;
  }

  writeDetail(frame, places) {
    const i = this.chosen;
    this.detail.hidden = !i;
    if (!i) return;
    if (this.detailOf !== i) {
      this.detailOf = i;
      this.heardOf = (this.incoming.get(i) ?? []).map(([src, link]) => {
        const text = make("span");
        const button = make("button", { type: "button", class: "fleet-link", onclick: () => this.handlers.onLink(src, i) }, text);
        return { src, link, text, el: make("li", {}, button) };
      });
      this.facts = make("p");
      this.commanded = make("p");
      const act = make("button", { type: "button", class: "fleet-button", onclick: () => this.handlers.onInject(i) }, "Disturb ...");
      this.detail.replaceChildren(
        make("h3", {}, `Vehicle ${i}`, ...(this.setup.may_act ? [act] : [])),
        this.facts,
        this.commanded,
        make("p", { class: "fleet-note" }, "What it hears of its neighbours:"),
        make("ul", {}, ...this.heardOf.map((one) => one.el)),
      );
    }
    const place = places.get(i);
    const turn = place ? ((place[5] * 180) / Math.PI + 360) % 360 : 0;
    const pitch = place ? (place[4] * 180) / Math.PI : 0;
    const roll = place && place.length > 7 ? `, roll ${((place[7] * 180) / Math.PI).toFixed(0)}°` : "";
    write(this.facts, place ? `north ${place[1].toFixed(1)} m, east ${place[2].toFixed(1)} m, heading ${turn.toFixed(0)}°, pitch ${pitch.toFixed(0)}°${roll}` : "-");
    const tau = COMMANDS.map(([, unit], k) => number(this.handlers.latest(`uuv/${i}/command.tau[${k}]`), 1, unit));
    write(this.commanded, `commands: ${COMMANDS.map(([what], k) => `${what} ${tau[k]}`).join(", ")}`);
    for (const { src, link, text } of this.heardOf) {
      write(text, `from ${src}: ${LINKS[frame.links[link]].name}, ${frame.ages[link].toFixed(1)} s old`);
      text.style.color = LINKS[frame.links[link]].colour;
    }
  }

  writeFaults(faults, t) {
    const listed = JSON.stringify(faults.map(({ id, active, until_healed }) => [id, active, until_healed]));
    if (listed !== this.listed) {
      this.listed = listed;
      this.left = faults.map((fault) => {
        const left = make("span", { class: "fleet-left" });
        const heal = make("button", { type: "button", class: "fleet-button", onclick: () => this.handlers.onHeal(fault.id) }, "Heal");
        heal.setAttribute("aria-label", `Heal ${fault.id}`);
        return {
          fault,
          left,
          el: make(
            "li",
            { class: fault.active ? "active" : "to-come" },
            make("span", { class: "fleet-what" }, fault.what),
            left,
            ...(this.setup.may_act && fault.active ? [heal] : []),
          ),
        };
      });
      const none = make("li", { class: "fleet-note" }, "no fault");
      this.faults.replaceChildren(...(this.left.length ? this.left.map((one) => one.el) : [none]));
    }
    faults.forEach((fault, k) => {
      const left = fault.to_s - t;
      const text = !fault.active
        ? `in ${(fault.from_s - t).toFixed(1)} s`
        : fault.until_healed
          ? "until healed"
          : fault.to_s >= this.setup.end_s
            ? "to the end"
            : `${left.toFixed(1)} s left`;
      write(this.left[k].left, text);
    });
  }

  writeChecks({ rows: checks, final }) {
    const some = checks.some(({ passed }) => passed != null);
    write(this.checkTitle, final ? "Checks, of the whole run" : some ? "Checks, so far" : "Checks, not judged yet");
    const marks = { true: ["✓", "pass"], false: ["✗", "fail"], null: ["○", "open"] };
    this.checks.replaceChildren(
      ...checks.map(({ check, asked, passed, found }) => {
        const [mark, kind] = marks[passed];
        const name = check.replaceAll("_", " ");
        const says = passed == null ? (some ? `${asked}; not judged yet` : asked) : `${asked}; found ${found}`;
        const words = final ? { pass: "passed", fail: "failed" } : { pass: "passes so far", fail: "fails" };
        const word = words[kind] ?? "not judged yet";
        return make(
          "li",
          { class: kind, title: word },
          make("span", { class: "fleet-mark", ariaLabel: word, role: "img" }, mark),
          make("span", {}, make("b", {}, name), ` ${says}`),
        );
      }),
    );
    if (!checks.length) this.checks.append(make("li", { class: "fleet-note" }, "the scenario asks for none"));
  }

  writeCommands(commands) {
    this.commandPanel.hidden = !commands.length;
    this.commands.replaceChildren(
      ...[...commands].reverse().map((command) => {
        const copy = make("button", { type: "button", class: "fleet-button", onclick: () => copyText(command, copy) }, "Copy");
        return make("li", {}, make("code", {}, command), copy);
      }),
    );
  }
}

// The clipboard is there on loopback and over TLS only; elsewhere the text is selected.
export async function copyText(text, button) {
  try {
    await navigator.clipboard.writeText(text);
    write(button, "Copied");
  } catch {
    window.prompt("Copy this:", text);
  }
}
