// The links as a list for the keyboard: the worst first, and those that are looked for.
import { LINKS } from "./colours.js";
import { make, old, write } from "./dom.js";

const EVERY_MS = 500;
const MOST_WORST = 6;
const MOST_FOUND = 60;

export class LinkList {
  constructor(setup, { onLink, onPoint }) {
    this.setup = setup;
    this.handlers = { onLink, onPoint };
    this.rank = new Map(setup.worst_first.map((state, k) => [state, k]));
    this.summary = make("p", { class: "fleet-note" });
    this.kinds = make("p", { class: "fleet-note" });
    this.find = make("input", { class: "fleet-find", type: "search", placeholder: "find: 3, 2->3, cut ...", ariaLabel: "Find links by vehicle, ends or state", oninput: () => this.show() });
    this.list = make("ul", { class: "fleet-links", onkeydown: (event) => this.move(event) });
    this.more = make("p", { class: "fleet-note" });
    this.el = make("div", {}, this.summary, this.find, this.list, this.more, this.kinds);
    this.rows = new Map();
    this.drawn = 0;
  }

  frame(frame) {
    this.now = frame;
    const at = performance.now();
    if (at - this.drawn < EVERY_MS && !frame.clock.paused) return;
    this.drawn = at;
    this.show();
  }

  show() {
    if (!this.now) return;
    const { t, since, links, kinds } = this.now;
    const counts = this.setup.worst_first.map((state) => [state, links.filter((one) => one === state).length]);
    write(this.summary, counts.filter(([, count]) => count).map(([state, count]) => `${count} ${state}`).join(", "));
    const shares = kinds.slice(0, 5).map(([kind, all, lost]) => `${kind} ${all}${lost ? `, ${((100 * lost) / all).toFixed(0)} % lost` : ""}`);
    write(this.kinds, shares.length ? `Packets ${since && t - since < 60 ? `since ${since.toFixed(1)} s` : "of the last minute"} by payload: ${shares.join("; ")}` : "");
    const wanted = this.wanted();
    // While somebody is in the list it keeps its order, so that nothing moves away from under a finger or a key.
    const held = this.list.contains(document.activeElement) || this.list.matches(":hover");
    if (!held || wanted !== this.of) this.order(wanted);
    for (const k of this.rows.keys()) this.writeRow(k);
  }

  wanted() {
    return this.find.value.trim().toLowerCase();
  }

  order(wanted) {
    this.of = wanted;
    const found = this.setup.links.map((_, k) => k).filter((k) => this.matches(k, wanted)).sort((a, b) => this.badness(a, b));
    const shown = found.slice(0, wanted ? MOST_FOUND : MOST_WORST);
    const known = this.rows;
    this.rows = new Map(shown.map((k) => [k, known.get(k) ?? this.row(k)]));
    const rows = [...this.rows.values()];
    if (rows.some((row, at) => this.list.children[at] !== row) || this.list.children.length !== rows.length) this.list.replaceChildren(...rows);
    const left = found.length - shown.length;
    const best = left ? new Set(found.slice(shown.length).map((k) => this.now.links[k])) : new Set();
    write(this.more, left ? `and ${left} more${best.size === 1 ? `, all ${[...best][0]}` : ""}` : found.length ? "" : "no such link");
  }

  matches(k, wanted) {
    if (!wanted) return true;
    const [src, dst] = this.setup.links[k];
    const ends = wanted.match(/^(\d*)\s*(<->|->|→|-)\s*(\d*)$/);
    if (ends) {
      const fits = (a, b) => (!ends[1] || a === Number(ends[1])) && (!ends[3] || b === Number(ends[3]));
      return fits(src, dst) || (["-", "<->"].includes(ends[2]) && fits(dst, src));
    }
    if (/^\d+$/.test(wanted)) return [src, dst].includes(Number(wanted));
    return this.now.links[k].startsWith(wanted);
  }

  badness(a, b) {
    const { links, losses, ages } = this.now;
    return this.rank.get(links[a]) - this.rank.get(links[b]) || losses[b] - losses[a] || (ages[b] ?? Infinity) - (ages[a] ?? Infinity) || a - b;
  }

  row(k) {
    const [src, dst] = this.setup.links[k];
    const point = (yes) => this.handlers.onPoint(yes ? k : null);
    const button = make("button", {
      type: "button", class: "fleet-link",
      onclick: () => this.handlers.onLink(src, dst),
      onfocus: () => point(true), onblur: () => point(false),
      onpointerenter: () => point(true), onpointerleave: () => point(false),
    });
    return make("li", {}, button);
  }

  writeRow(k) {
    const { links, losses, ages, since } = this.now;
    const [src, dst] = this.setup.links[k];
    const name = links[k];
    const lost = losses[k] ? `, ${losses[k]} of the last ten lost` : "";
    const button = this.rows.get(k).firstChild;
    write(button, `${this.setup.names[src - 1]} → ${this.setup.names[dst - 1]}: ${name}${lost}, ${old(ages[k], since)}`);
    button.style.color = LINKS[name].colour;
  }

  move(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step) return;
    const buttons = [...this.list.querySelectorAll("button")];
    const next = buttons[buttons.indexOf(document.activeElement) + step];
    if (!next) return;
    event.preventDefault();
    next.focus();
  }
}
