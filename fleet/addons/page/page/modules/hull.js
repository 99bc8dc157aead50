// A torpedo: its outline between two points on its axis, as seen from anywhere.
const OUTLINE = [[0, 0.25], [0.1, 0.6], [0.25, 1], [0.8, 1], [0.92, 0.72], [0.98, 0.35], [1, 0]]; // along, half width
// Pixels that a hull is long at least, so that it can be seen in any formation; less where there are many.
const least = (vehicles) => (vehicles <= 12 ? 46 : vehicles <= 40 ? 34 : 20);

// How long and thick a hull is drawn [m]: larger than it is where it would be too small to be seen.
export function drawnSize([length, width], scale, vehicles) {
  const drawn = Math.max(length, least(vehicles) / scale);
  return [drawn, Math.max(width * (drawn / length), (0.2 * least(vehicles)) / scale)];
}

export function axis([, n, e, d, pitch, heading], length) {
  const half = length / 2;
  const across = half * Math.cos(pitch);
  const forward = [across * Math.cos(heading), across * Math.sin(heading), -half * Math.sin(pitch)];
  return [
    [n - forward[0], e - forward[1], d - forward[2]],
    [n + forward[0], e + forward[1], d + forward[2]],
  ];
}

export function drawHull(g, tail, nose, thick, colour, { silent, chosen }) {
  const [dx, dy] = [nose[0] - tail[0], nose[1] - tail[1]];
  const length = Math.hypot(dx, dy);
  const [ux, uy] = length > 0.01 ? [dx / length, dy / length] : [0, -1];
  const at = (along, aside) => [tail[0] + along * dx - aside * uy, tail[1] + along * dy + aside * ux];
  const half = thick / 2;
  g.save();
  g.lineJoin = "round";
  g.fillStyle = g.strokeStyle = colour;
  g.lineWidth = Math.max(1.5, 0.18 * thick);
  g.beginPath(); // the fins
  for (const side of [-1, 1]) {
    g.moveTo(...at(0.16, side * half * 0.6));
    g.lineTo(...at(-0.02, side * half * 1.9));
    g.lineTo(...at(0.02, side * half * 0.4));
  }
  g.fill();
  g.beginPath();
  for (const [along, wide] of OUTLINE) g.lineTo(...at(along, wide * half));
  for (const [along, wide] of [...OUTLINE].reverse()) g.lineTo(...at(along, -wide * half));
  g.closePath();
  const shade = g.createLinearGradient(...at(0.5, -half), ...at(0.5, half));
  shade.addColorStop(0, silent ? "#c5ced8" : "#ffffff");
  shade.addColorStop(0.45, colour);
  shade.addColorStop(1, colour);
  g.fillStyle = shade;
  g.fill();
  g.strokeStyle = chosen ? "#ffffff" : "#06121f";
  g.lineWidth = chosen ? 2.5 : 1;
  g.stroke();
  if (length < thick) { // seen from ahead or behind
    g.beginPath();
    g.arc((tail[0] + nose[0]) / 2, (tail[1] + nose[1]) / 2, half, 0, 7);
    g.fillStyle = colour;
    g.fill();
    g.stroke();
  }
  g.restore();
}
