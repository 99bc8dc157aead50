// What the colours and dashes of links mean.
import { HULLS, LINKS, PACKETS, isCrowd } from "./colours.js";
import { make } from "./dom.js";

export function legend(setup) {
  const { obstacles_m: obstacles, vehicles } = setup;
  const shown = Object.entries(LINKS).filter(([state]) => state !== "silent");
  const rows = shown.map(([, { name, colour, width, dash, says }]) => {
    const line = `<svg width="30" height="8" aria-hidden="true"><line x1="0" y1="4" x2="30" y2="4" stroke="${colour}" stroke-width="${width}" stroke-dasharray="${dash.join(" ")}"/></svg>`;
    const row = make("span", { title: says }, name);
    row.insertAdjacentHTML("afterbegin", line);
    return row;
  });
  const packet = make("span", { title: "a packet on its way" }, "packet");
  packet.insertAdjacentHTML("afterbegin", `<svg width="10" height="10" aria-hidden="true"><circle cx="5" cy="5" r="3" fill="${PACKETS.arrived}"/></svg>`);
  const place = make("span", { title: "where the vehicle should be" }, "desired place");
  place.insertAdjacentHTML("afterbegin", `<svg width="18" height="16" aria-hidden="true"><circle cx="9" cy="8" r="6.5" fill="none" stroke="#b9cbdd" stroke-dasharray="3 3" stroke-width="1.5"/></svg>`);
  const more = obstacles.length ? [make("span", { title: "a cylinder that vehicles are to keep out of" }, "obstacle")] : [];
  for (const row of more) row.insertAdjacentHTML("afterbegin", `<svg width="18" height="16" aria-hidden="true"><circle cx="9" cy="8" r="6.5" fill="#c8d4e0" fill-opacity="0.25" stroke="#dce4ec"/></svg>`);
  if (vehicles > HULLS.length) more.push(make("span", { class: "fleet-note" }, `colours repeat after ${HULLS.length} vehicles`));
  if (isCrowd(setup)) more.push(make("span", { class: "fleet-note" }, "numbers: the five that are farthest off their places"));
  return make("div", { class: "fleet-legend" }, ...rows, ...(isCrowd(setup) ? [] : [packet]), place, ...more);
}
