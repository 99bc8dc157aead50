// Paints the primitives of fleet/recorder/scene/primitives.py. A point is [frame, north, east, down], counted from its frame.
import { colour, glass } from "./colours.js";

const TURNS = Array.from({ length: 49 }, (_, k) => (k * Math.PI) / 24);
const LEAST_PX = 20; // of a line: a shorter one shows nothing

// Where a point is [m, NED]; null: its frame is nowhere.
export function place([frame, ...offset], frames) {
  const at = frames.get(frame);
  return at ? at.map((value, k) => value + offset[k]) : null;
}

export const pointsOf = ({ at, points }) => points ?? (at ? [at] : []);

const PAINT = {
  // From the surface, or as far up as one sees, to the floor.
  cylinder(g, { north, east, radius, colour: word }, { camera, project, floor }) {
    const top = Math.max(0, camera.centre[2] - 1.5 * camera.radius);
    const ring = (down) => TURNS.map((turn) => project([north + radius * Math.cos(turn), east + radius * Math.sin(turn), down]));
    const [low, high] = [ring(floor), ring(top)];
    g.strokeStyle = glass(word, 0.55);
    g.lineWidth = 1.2;
    g.fillStyle = glass(word, 0.05);
    for (let k = 0; !camera.above && k + 1 < TURNS.length; k++) polygon(g, [low[k], low[k + 1], high[k + 1], high[k]], false);
    g.fillStyle = glass(word, 0.16);
    for (const points of camera.above ? [low] : [low, high]) polygon(g, points, true);
  },

  circle(g, { at, colour: word }, { project, frames }) {
    const [x, y] = project(place(at, frames));
    g.strokeStyle = glass(word, 0.75);
    g.lineWidth = 1.5;
    g.setLineDash([3, 3]);
    g.beginPath();
    g.arc(x, y, 9, 0, 7);
    g.stroke();
  },

  cross(g, { at, text, colour: word }, { project, frames }) {
    const [x, y] = project(place(at, frames));
    g.strokeStyle = colour(word);
    g.lineWidth = 1.5;
    g.beginPath();
    g.moveTo(x - 7, y);
    g.lineTo(x + 7, y);
    g.moveTo(x, y - 7);
    g.lineTo(x, y + 7);
    g.stroke();
    g.fillStyle = glass(word, 0.75);
    g.font = "11px system-ui, sans-serif";
    g.fillText(text, x + 8, y + 17);
  },

  area(g, { points, colour: word }, { project, frames }) {
    g.strokeStyle = glass(word, 0.7);
    g.lineWidth = 1;
    g.fillStyle = glass(word, 0.16);
    polygon(g, points.map((point) => project(place(point, frames))), true);
  },

  line(g, { points, colour: word }, { project, frames }) {
    const [first, ...others] = points.map((point) => project(place(point, frames)));
    const last = others[others.length - 1];
    if (others.length === 1 && Math.hypot(last[0] - first[0], last[1] - first[1]) < LEAST_PX) return;
    g.strokeStyle = glass(word, 0.4);
    g.lineWidth = 1.5;
    g.setLineDash([3, 3]);
    g.beginPath();
    g.moveTo(...first);
    for (const [x, y] of others) g.lineTo(x, y);
    g.stroke();
  },
};

// `view`: the camera, its projection, the floor [m] and the frames.
export function paint(g, things, view) {
  for (const thing of things) {
    if (!pointsOf(thing).every((point) => view.frames.has(point[0]))) continue;
    PAINT[thing.kind](g, thing, view);
    g.setLineDash([]);
  }
}

function polygon(g, points, outlined) {
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  g.closePath();
  g.fill();
  if (outlined) g.stroke();
}
