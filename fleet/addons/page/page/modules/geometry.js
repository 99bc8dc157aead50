// Plane geometry in pixels.
export function distanceToSegment(x, y, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = dx * dx + dy * dy;
  const along = length ? Math.min(1, Math.max(0, ((x - a[0]) * dx + (y - a[1]) * dy) / length)) : 0;
  return Math.hypot(x - a[0] - along * dx, y - a[1] - along * dy);
}

// Two ends, moved sideways: the lane of one direction beside that of the other.
export function lane(a, b, aside, from, to) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = Math.hypot(dx, dy) || 1;
  const [ux, uy] = [dx / length, dy / length];
  const keep = Math.min(1, length / (from + to + 1));
  return [
    [a[0] + keep * from * ux - aside * uy, a[1] + keep * from * uy + aside * ux],
    [b[0] - keep * to * ux - aside * uy, b[1] - keep * to * uy + aside * ux],
  ];
}

export const between = (a, b, share) => [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];

// On which side of the line through a and b a point is: true on its left.
export const isLeft = (point, a, b) => (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) < 0;

// A round number of about this size: 1, 2 or 5 times a power of ten.
export function round(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  const first = size / power;
  return (first < 1.5 ? 1 : first < 3.5 ? 2 : first < 7.5 ? 5 : 10) * power;
}

// A point of a lane by its share of the way; a lane that is bent has a third point, towards which it is drawn.
export function along([a, b, bend], share) {
  if (!bend) return between(a, b, share);
  return between(between(a, bend, share), between(bend, b, share), share);
}

export function distanceToLane(x, y, lane) {
  if (!lane[2]) return distanceToSegment(x, y, lane[0], lane[1]);
  const points = [0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1].map((share) => along(lane, share));
  return Math.min(...points.slice(1).map((point, k) => distanceToSegment(x, y, points[k], point)));
}

// The lane, bent around points that it would pass through; `away`: how far it keeps from their middles.
export function bent([a, b], points, away) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = Math.hypot(dx, dy);
  if (length < 2 * away) return [a, b];
  let most = 0;
  for (const [x, y] of points) {
    const share = ((x - a[0]) * dx + (y - a[1]) * dy) / (length * length);
    if (share < 0.08 || share > 0.92) continue;
    const aside = ((x - a[0]) * dy - (y - a[1]) * dx) / length; // of the point, to the left of the way
    if (Math.abs(aside) >= away) continue;
    const needed = (away - Math.abs(aside)) / (2 * share * (1 - share));
    if (needed > Math.abs(most)) most = aside > 0 ? -needed : needed;
  }
  if (!most) return [a, b];
  const off = Math.max(-0.6 * length, Math.min(0.6 * length, most));
  return [a, b, [(a[0] + b[0]) / 2 + (off * dy) / length, (a[1] + b[1]) / 2 - (off * dx) / length]];
}
