// What stands beside the picture: checks, faults, vehicles, links, and the commands that had an effect.
import { LINKS } from "./colours.js";
import { copyText } from "./copy.js";
import { make, number, old, write } from "./dom.js";
import { LinkList } from "./links.js";
import { VehicleTable } from "./vehicles.js";
import { Checks, Faults } from "./verdict.js";

const EVERY_MS = 250;
const MOST_REPORTED = 4;
const COMMANDS = [["surge", "N"], ["pitch", "N m"], ["yaw", "N m"]];
const panel = (title, ...children) =>
  make("section", { class: "fleet-panel" }, make("h2", {}, title), ...children);

export class Panels {
  constructor(el, setup, handlers) {
    this.setup = setup;
    this.handlers = handlers;
    this.drawn = 0;
    const onTime = setup.live ? null : handlers.onTime;
    this.table = new VehicleTable(setup, handlers);
    this.detail = make("div", { class: "fleet-detail", hidden: true });
    this.faults = new Faults(setup, { onHeal: handlers.onHeal, onTime });
    this.links = new LinkList(setup, handlers);
    this.commands = make("ul", { class: "fleet-commands" });
    this.commandPanel = panel("Commands behind what was done here", this.commands);
    this.commandPanel.hidden = true;
    const checks = panel("Checks");
    this.checks = new Checks(checks.firstChild, onTime);
    checks.append(this.checks.el);
    const { faults } = this;
    el.append(
      checks,
      panel("Faults", faults.el, faults.past, faults.eventTitle, faults.events),
      panel("Vehicles", this.table.el, this.detail),
      panel("Links", this.links.el),
      this.commandPanel,
    );
  }

  get chosen() {
    return this.table.chosen;
  }

  frame(frame) {
    this.table.frame(frame);
    this.links.frame(frame);
    const at = performance.now();
    if (at - this.drawn < EVERY_MS && !frame.clock.paused) return;
    this.drawn = at;
    this.writeDetail(frame, frame.uuv.find(([i]) => i === this.chosen));
    this.faults.write(frame.faults, frame.t);
  }

  choose(i) {
    this.drawn = this.detailOf = 0;
    return this.table.choose(i);
  }

  writeDetail(frame, place) {
    const i = this.chosen;
    this.detail.hidden = !i;
    if (!i) return;
    if (this.detailOf !== i) this.makeDetail(i);
    const turn = place ? ((place[5] * 180) / Math.PI + 360) % 360 : 0;
    const pitch = place ? (place[4] * 180) / Math.PI : 0;
    const roll = place && place.length > 7 ? `, roll ${((place[7] * 180) / Math.PI).toFixed(0)}°` : "";
    write(this.facts, place ? `north ${place[1].toFixed(1)} m, east ${place[2].toFixed(1)} m, heading ${turn.toFixed(0)}°, pitch ${pitch.toFixed(0)}°${roll}` : "-");
    const tau = COMMANDS.map(([, unit], k) => number(this.handlers.latest(`uuv/${i}/command.tau_${k}`, i), 1, unit));
    write(this.commanded, `commands: ${COMMANDS.map(([what], k) => `${what} ${tau[k]}`).join(", ")}`);
    for (const { src, link, text } of this.heardOf) {
      write(text, `from ${src}: ${frame.links[link]}, ${old(frame.ages[link], frame.since)}`);
      text.style.color = LINKS[frame.links[link]].colour;
    }
  }

  makeDetail(i) {
    this.detailOf = i;
    this.heardOf = (this.table.incoming.get(i) ?? []).map(([src, link]) => {
      const text = make("span");
      const button = make("button", { type: "button", class: "fleet-link", onclick: () => this.handlers.onLink(src, i) }, text);
      return { src, link, text, el: make("li", {}, button) };
    });
    this.facts = make("p");
    this.commanded = make("p");
    const act = make("button", { type: "button", class: "fleet-button", onclick: () => this.handlers.onInject(i) }, `Disturb vehicle ${i} ...`);
    this.detail.replaceChildren(
      make("h3", {}, `Vehicle ${i}`, ...(this.setup.may_act ? [act] : [])),
      this.facts,
      this.commanded,
      make("p", { class: "fleet-note" }, "What it hears of its neighbours:"),
      make("ul", {}, ...this.heardOf.map((one) => one.el)),
    );
  }

  // Of moored vehicles the table shows from the start what their agents report.
  offer({ fleet }) {
    const reported = Object.keys(fleet).filter((name) => name.startsWith("control."));
    if (this.setup.moored && !this.offered && reported.length) this.table.setColumns(reported.slice(0, MOST_REPORTED));
    this.offered = true;
  }

  writeCommands(commands) {
    this.commandPanel.hidden = !commands.length;
    this.commands.replaceChildren(
      ...[...commands].reverse().map((command, k) => {
        const copy = make("button", { type: "button", class: "fleet-button", onclick: () => copyText(command, copy) }, "Copy");
        copy.setAttribute("aria-label", `Copy command ${commands.length - k}: ${command}`);
        return make("li", {}, make("code", {}, command), copy);
      }),
    );
  }
}
