// Vertical cylinders that vehicles are to keep out of: glass from the surface, or as far up as one sees, to the floor.
const TURNS = Array.from({ length: 49 }, (_, k) => (k * Math.PI) / 24);

export function drawObstacles(g, obstacles, { camera, project, floor }) {
  const top = Math.max(0, camera.centre[2] - 1.5 * camera.radius);
  g.strokeStyle = "rgba(220, 228, 236, 0.55)";
  g.lineWidth = 1.2;
  for (const [n, e, radius] of obstacles) {
    const ring = (down) => TURNS.map((turn) => project([n + radius * Math.cos(turn), e + radius * Math.sin(turn), down]));
    const [low, high] = [ring(floor), ring(top)];
    g.fillStyle = "rgba(200, 212, 224, 0.05)";
    for (let k = 0; !camera.above && k + 1 < TURNS.length; k++) polygon(g, [low[k], low[k + 1], high[k + 1], high[k]], false);
    g.fillStyle = "rgba(200, 212, 224, 0.16)";
    for (const points of camera.above ? [low] : [low, high]) polygon(g, points, true);
  }
}

function polygon(g, points, outlined) {
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  g.closePath();
  g.fill();
  if (outlined) g.stroke();
}
