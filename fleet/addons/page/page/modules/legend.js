// What the signs mean, as fleet/recorder/scene/model.py says.
import { LINKS, colour, hulls } from "./colours.js";
import { make } from "./dom.js";

const svg = (width, height, shape) => `<svg width="${width}" height="${height}" aria-hidden="true">${shape}</svg>`;
const disc = (style) => svg(18, 16, `<circle cx="9" cy="8" r="6.5" ${style}/>`);
const line = (stroke, width, dash) => svg(30, 8, `<line x1="0" y1="4" x2="30" y2="4" stroke="${stroke}" stroke-width="${width}" stroke-dasharray="${dash.join(" ")}"/>`);

const SAMPLES = {
  link: (state) => line(LINKS[state].colour, LINKS[state].width, LINKS[state].dash),
  packet: (word) => svg(10, 10, `<circle cx="5" cy="5" r="3" fill="${colour(word)}"/>`),
  circle: () => disc('fill="none" stroke="#b9cbdd" stroke-dasharray="3 3" stroke-width="1.5"'),
  cylinder: (word) => disc(`fill="${colour(word)}" fill-opacity="0.2" stroke="${colour(word)}"`),
  area: (word) => svg(24, 16, `<ellipse cx="12" cy="8" rx="11" ry="6.5" fill="${colour(word)}" fill-opacity="0.2" stroke="${colour(word)}"/><path d="M8 8h8M12 4v8" stroke="${colour(word)}"/>`),
  line: (word) => line(colour(word), 1.5, [3, 3]),
};

export function legend({ legend: rows, vehicles, crowd }) {
  const signs = rows.map(({ sign, word, name, meaning }) => {
    const row = make("span", { title: meaning }, name);
    row.insertAdjacentHTML("afterbegin", SAMPLES[sign](word));
    return row;
  });
  const note = (text) => make("span", { class: "fleet-note" }, text);
  if (vehicles > hulls()) signs.push(note(`colours repeat after ${hulls()} vehicles`));
  if (crowd) signs.push(note("numbers: the five that are farthest off their places"));
  return make("div", { class: "fleet-legend" }, ...signs);
}
