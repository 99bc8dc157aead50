// What decides first: the checks, those that failed on top; then the faults, and what happened to vehicles.
import { make, write } from "./dom.js";

const ORDER = { fail: 0, open: 1, pass: 2 };
const MARKS = { true: ["✓", "pass"], false: ["✗", "fail"], null: ["○", "open"] };
const MOST_PAST = 30; // faults and vehicles that are listed

export class Checks {
  constructor(title, onTime) {
    this.title = title;
    this.onTime = onTime;
    this.el = make("ul", { class: "fleet-checks" });
  }

  write({ rows, final }) {
    const some = rows.some(({ passed }) => passed != null);
    write(this.title, final ? "Checks, of the whole run" : some ? "Checks, so far" : "Checks, not judged yet");
    const words = final ? { pass: "passed", fail: "failed" } : { pass: "passes so far", fail: "fails" };
    const ordered = [...rows].sort((a, b) => ORDER[MARKS[a.passed][1]] - ORDER[MARKS[b.passed][1]]);
    this.el.replaceChildren(...ordered.map((row) => this.row(row, some, words)));
    if (!rows.length) this.el.append(make("li", { class: "fleet-note" }, "the scenario asks for none"));
  }

  row({ check, asked, passed, found, at_s }, some, words) {
    const [mark, kind] = MARKS[passed];
    const says = passed == null ? (some ? `${asked}; not judged yet` : asked) : `${asked}; found ${found}`;
    const word = words[kind] ?? "not judged yet";
    return make(
      "li",
      { class: kind, title: word },
      make("span", { class: "fleet-mark", ariaLabel: word, role: "img" }, mark),
      make("span", {}, make("b", {}, check.replaceAll("_", " ")), ` ${says}`, ...timeButton(at_s, `when ${check} failed`, this.onTime)),
    );
  }
}

// In a few words how the run stands.
export function verdict({ rows, final, verdict: known }) {
  if (final && known) {
    const [mark, kind] = MARKS[known.passed];
    return [kind, `${mark} ${known.text}`];
  }
  const failing = rows.filter(({ passed }) => passed === false).length;
  if (failing) return ["fail", `✗ ${failing} of ${rows.length} checks ${failing > 1 ? "fail" : "fails"}`];
  return rows.some(({ passed }) => passed) ? ["pass", "✓ passes so far"] : ["", ""];
}

export class Faults {
  constructor(setup, { onHeal, onTime }) {
    this.setup = setup;
    this.onHeal = onHeal;
    this.onTime = onTime;
    this.el = make("ul", { class: "fleet-faults" });
    this.past = make("ul", { class: "fleet-past" });
    this.events = make("ul", { class: "fleet-events" });
    this.eventTitle = make("h2", { hidden: true }, setup.live ? "What happened to vehicles" : "What happened to vehicles, of the whole run");
    this.all = [];
    this.listed = this.over = "";
    this.write([], 0);
  }

  known({ faults, events }) {
    this.all = faults;
    this.over = "";
    this.eventTitle.hidden = !events.length;
    const shown = events.slice(0, MOST_PAST).map(({ text, at_s }) => make("li", {}, make("span", { class: "fleet-what" }, text), ...timeButton(at_s, text, this.onTime)));
    if (events.length > MOST_PAST) shown.push(make("li", { class: "fleet-note" }, `and ${events.length - MOST_PAST} more`));
    this.events.replaceChildren(...shown);
  }

  write(faults, t) {
    const listed = JSON.stringify(faults.map(({ id, active, until_healed }) => [id, active, until_healed]));
    if (listed !== this.listed) {
      this.listed = listed;
      this.left = faults.map((fault) => this.row(fault));
      const none = make("li", { class: "fleet-note" }, "no fault now");
      this.el.replaceChildren(...(this.left.length ? this.left.map((one) => one.el) : [none]));
    }
    faults.forEach((fault, k) => write(this.left[k].left, this.time(fault, t)));
    this.writePast(t);
  }

  row(fault) {
    const left = make("span", { class: "fleet-left" });
    const heal = make("button", { type: "button", class: "fleet-button", onclick: () => this.onHeal(fault.id) }, "Heal");
    heal.setAttribute("aria-label", `Heal ${fault.id}`);
    const more = this.setup.may_act && fault.active ? [heal] : [];
    const el = make("li", { class: fault.active ? "active" : "to-come" }, make("span", { class: "fleet-what" }, fault.what), left, ...more);
    return { left, el };
  }

  time(fault, t) {
    if (!fault.active) return `in ${(fault.from_s - t).toFixed(1)} s`;
    if (fault.until_healed) return "until healed";
    return fault.to_s >= this.setup.end_s ? "to the end" : `${(fault.to_s - t).toFixed(1)} s left`;
  }

  // Those that are over, the last one first.
  writePast(t) {
    const past = this.all.filter(({ to_s, until_healed }) => to_s <= t && !until_healed).sort((a, b) => b.to_s - a.to_s);
    const over = past.map(({ id, to_s }) => `${id} ${to_s}`).join();
    if (over === this.over) return;
    this.over = over;
    const rows = past.slice(0, MOST_PAST).map(({ id, what, from_s, to_s }) =>
      make("li", {}, make("span", { class: "fleet-what" }, what), make("span", { class: "fleet-left" }, `over, ${seconds(from_s)} to ${seconds(to_s)} s`), ...timeButton(from_s, `${what} (${id})`, this.onTime)));
    if (past.length > MOST_PAST) rows.push(make("li", { class: "fleet-note" }, `and ${past.length - MOST_PAST} before`));
    this.past.replaceChildren(...rows);
  }
}

const seconds = (value) => Number(value.toFixed(2));

// A button that goes to a moment of a log; of a live run there is none.
function timeButton(at_s, what, onTime) {
  if (at_s == null || !onTime) return [];
  const button = make("button", { type: "button", class: "fleet-link fleet-go", onclick: () => onTime(at_s) }, `▸ ${seconds(at_s)} s`);
  button.setAttribute("aria-label", `Go to ${seconds(at_s)} s: ${what}`);
  return [" ", button];
}
