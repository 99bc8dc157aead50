// The fleet on a canvas: hulls, trails, desired places, links and packets; and what is under the pointer.
import { Camera } from "./camera.js";
import { LINKS, colour, hull } from "./colours.js";
import { along, bent, distanceToLane, isLeft, lane, round } from "./geometry.js";
import { fitted, old } from "./dom.js";
import { axis, drawHull, drawnSize } from "./hull.js";
import { Packets, drawCross } from "./packets.js";
import { paint, place, pointsOf } from "./primitives.js";

const FRAME_MS = 33;
const LINK_PX = 8; // that a click may miss a link by
const HULL_PX = 18;
const LABEL_PX = 17; // its height
const AWAY_PX = 17; // that a link keeps from a vehicle that it is not of

export class Scene {
  constructor(el, setup, { onLink, onVehicle, onLine }) {
    this.setup = setup;
    this.handlers = { onLink, onVehicle, onLine };
    this.camera = new Camera();
    this.packets = new Packets(setup);
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute(
      "aria-label",
      "The fleet and its links. Arrow keys turn the view, plus and minus zoom, t looks from above, 0 resets it.",
    );
    this.tip = document.createElement("div");
    this.tip.className = "fleet-tip";
    this.tip.hidden = true;
    el.append(this.canvas, this.tip);
    this.before = null;
    this.now = null;
    this.trails = new Map();
    this.lanes = [];
    this.corners = new Map(); // of labels, by vehicle
    this.spots = [];
    this.chosen = 0;
    this.over = null; // what is under the pointer
    this.line = null; // that is being drawn through the fleet
    this.drawing = false;
    this.moving = setup.moving;
    this.dirty = true;
    this.listen();
    this.sized = new ResizeObserver(() => this.resize());
    this.sized.observe(this.canvas);
    this.last = 0;
    const loop = (at) => {
      this.request = requestAnimationFrame(loop);
      if (at - this.last < FRAME_MS - 4 || (!this.dirty && !this.packets.moving && !this.isMoving(at))) return;
      this.last = at;
      this.draw(at);
    };
    this.request = requestAnimationFrame(loop);
  }

  end() {
    cancelAnimationFrame(this.request);
    this.sized.disconnect();
  }

  resize() {
    Object.assign(this, fitted(this.canvas));
    this.dirty = true;
  }

  frame(frame) {
    const at = performance.now();
    const jump = this.now && (frame.t < this.now.frame.t || frame.t > this.now.frame.t + 5);
    this.before = jump ? null : this.now;
    this.now = { at, frame };
    if (jump) {
      this.packets.clear();
      this.camera.jump();
    }
    this.moving = frame.moving ?? this.moving;
    this.labelled = new Set(frame.labelled);
    if (!this.setup.crowd) this.packets.take(frame.packets, frame.clock.rate || 1, at);
    this.samples(frame.samples);
    this.dirty = true;
  }

  history(history) {
    this.trails.clear();
    this.samples(history.samples);
  }

  samples(samples) {
    for (const [t, , , , places] of samples) {
      for (let k = 0; k < places.length; k += 4) {
        const i = places[k];
        if (!this.trails.has(i)) this.trails.set(i, []);
        const trail = this.trails.get(i);
        if (trail.length && trail[trail.length - 1][3] >= t) continue;
        trail.push([places[k + 1], places[k + 2], places[k + 3], t]);
        while (trail.length && trail[0][3] < t - this.setup.trail_s) trail.shift();
      }
    }
  }

  isMoving(at) {
    return this.before && at - this.now.at < 1.5 * (this.now.at - this.before.at);
  }

  // Between two frames vehicles glide from one to the other, so that they move smoothly at any rate.
  vehicles(at) {
    const { frame } = this.now;
    if (!this.before) return frame.uuv;
    const share = Math.min(1, (at - this.now.at) / Math.max(1, this.now.at - this.before.at));
    const earlier = new Map(this.before.frame.uuv.map((row) => [row[0], row]));
    return frame.uuv.map((row) => {
      const old = earlier.get(row[0]);
      if (!old) return row;
      const mix = (k) => old[k] + share * (row[k] - old[k]);
      return [row[0], mix(1), mix(2), mix(3), row[4], row[5], row[6]];
    });
  }

  draw(at) {
    const { g, width, height } = this;
    if (!g || !width) return;
    this.dirty = false;
    const sea = g.createLinearGradient(0, 0, 0, height);
    sea.addColorStop(0, "#12334d");
    sea.addColorStop(1, "#071524");
    g.fillStyle = sea;
    g.fillRect(0, 0, width, height);
    if (!this.now || !this.now.frame.uuv.length) return;
    const { frame } = this.now;
    const rows = this.vehicles(at);
    const places = new Map(rows.map((row) => [row[0], row]));
    const frames = new Map([["ned", [0, 0, 0]], ["reference", frame.ref], ...rows.map((row) => [`uuv-${row[0]}`, row.slice(1, 4)])]);
    const { camera, moving } = this;
    const seen = [...rows.map((row) => row.slice(1, 4)), ...moving.flatMap(pointsOf).map((point) => place(point, frames)).filter(Boolean)];
    camera.follow(seen);
    const { project, scale } = camera.projection(width, height);
    const floor = Math.max(...seen.map((at) => at[2])) + 0.35 * camera.radius;
    this.drawFloor(project, floor);
    if (!camera.above && !this.setup.crowd) this.drawStems(rows, project, floor);
    this.drawTrails(rows, project);
    paint(g, [...this.setup.standing, ...moving], { camera, project, floor, frames });
    if (this.setup.acoustic) this.packets.drawRings(g, places, 2 * camera.radius, project, at);
    this.drawLinks(frame, places, project);
    this.packets.draw(g, this.lanes, at);
    this.drawHulls(frame, rows, project, scale);
    this.drawCompass(project);
    if (this.line) this.drawLine();
  }

  drawFloor(project, floor) {
    const { g, camera } = this;
    const step = round(camera.radius / 2.5 / Math.min(4, Math.max(0.5, camera.zoom)));
    const reach = Math.ceil((2.6 * camera.radius) / step) * step;
    const [n0, e0] = camera.centre.map((value) => Math.round(value / step) * step);
    g.lineWidth = 1;
    for (let k = -reach; k <= reach + 1e-6; k += step) {
      const fade = 0.28 * (1 - Math.abs(k) / (1.15 * reach));
      g.strokeStyle = `rgba(140, 190, 230, ${fade})`;
      g.beginPath();
      for (const [a, b] of [[[n0 + k, e0 - reach], [n0 + k, e0 + reach]], [[n0 - reach, e0 + k], [n0 + reach, e0 + k]]]) {
        const [p, q] = [project([...a, floor]), project([...b, floor])];
        g.moveTo(p[0], p[1]);
        g.lineTo(q[0], q[1]);
      }
      g.stroke();
    }
    this.step = step;
  }

  drawStems(rows, project, floor) {
    const { g } = this;
    for (const row of rows) {
      const [top, foot] = [project(row.slice(1, 4)), project([row[1], row[2], floor])];
      g.strokeStyle = "rgba(170, 210, 240, 0.28)";
      g.setLineDash([2, 4]);
      g.beginPath();
      g.moveTo(top[0], top[1]);
      g.lineTo(foot[0], foot[1]);
      g.stroke();
      g.setLineDash([]);
      g.fillStyle = "rgba(0, 0, 0, 0.35)";
      g.beginPath();
      g.ellipse(foot[0], foot[1], 9, 9 * Math.sin(this.camera.elevation), 0, 0, 7);
      g.fill();
    }
  }

  drawTrails(rows, project) {
    const { g } = this;
    g.lineWidth = 2;
    g.lineCap = "round";
    for (const row of rows) {
      const trail = this.trails.get(row[0]) ?? [];
      const points = [...trail, [row[1], row[2], row[3], this.now.frame.t]];
      g.strokeStyle = hull(row[0]);
      const part = Math.ceil(points.length / 6);
      for (let k = 0; k + 1 < points.length; k += part) {
        g.globalAlpha = 0.12 + 0.5 * (k / points.length);
        g.beginPath();
        for (const point of points.slice(k, k + part + 1)) {
          const [x, y] = project(point);
          g.lineTo(x, y);
        }
        g.stroke();
      }
    }
    g.globalAlpha = 1;
    g.lineCap = "butt";
  }

  drawLinks(frame, places, project) {
    const { g } = this;
    const { crowd } = this.setup;
    const at = [...places].map(([i, row]) => [i, project(row.slice(1, 4))]);
    this.lanes = this.setup.links.map(([src, dst], k) => {
      const [a, b] = [places.get(src), places.get(dst)];
      if (!a || !b) return null;
      const aside = this.setup.both_ways[k] ? 5 : 0;
      const straight = lane(project(a.slice(1, 4)), project(b.slice(1, 4)), aside, 20, 22);
      const others = crowd ? [] : at.filter(([i]) => i !== src && i !== dst).map(([, point]) => point);
      const ends = bent(straight, others, AWAY_PX);
      const state = frame.links[k] ?? "silent";
      const { colour: stroke, width, dash } = LINKS[state];
      const hit = this.over?.link === k;
      g.strokeStyle = g.fillStyle = stroke;
      g.globalAlpha = hit ? 1 : state === "delivering" ? (crowd ? 0.22 : 0.55) : 0.9;
      g.lineWidth = hit ? width + 2 : width;
      g.setLineDash(dash);
      g.beginPath();
      g.moveTo(...ends[0]);
      if (ends[2]) g.quadraticCurveTo(...ends[2], ...ends[1]);
      else g.lineTo(...ends[1]);
      g.stroke();
      g.setLineDash([]);
      this.drawTip([ends[2] ?? ends[0], ends[1]], state === "delivering" ? 6 : 8);
      if (state === "cut") {
        g.lineWidth = 3;
        drawCross(g, ...along(ends, 0.5), 5);
      }
      g.globalAlpha = 1;
      return ends;
    });
  }

  drawTip([a, b], size) {
    const { g } = this;
    const turn = Math.atan2(b[1] - a[1], b[0] - a[0]);
    g.beginPath();
    g.moveTo(...b);
    for (const side of [-0.4, 0.4]) {
      g.lineTo(b[0] - size * Math.cos(turn + side), b[1] - size * Math.sin(turn + side));
    }
    g.fill();
  }

  drawHulls(frame, rows, project, scale) {
    const { g } = this;
    const seen = rows.map((row) => ({ row, at: project(row.slice(1, 4)) })).sort((a, b) => b.at[2] - a.at[2]);
    const labels = new Map(frame.labels.map(([i, ...texts]) => [i, texts]));
    this.spots = [];
    this.boxes = []; // of the labels so far
    for (const { row, at } of seen) {
      const i = row[0];
      const silent = frame.no_agent.includes(i);
      const [length, thick] = drawnSize(this.setup.hulls_m[i - 1], scale, this.setup.vehicles);
      const [tail, nose] = axis(row, length).map(project);
      const chosen = this.chosen === i || this.over?.vehicle === i;
      drawHull(g, tail, nose, thick * scale, silent ? colour("no agent") : hull(i), { silent, chosen });
      this.spots.push({ i, x: at[0], y: at[1] });
      if (this.labelled.has(i) || chosen) this.drawLabel(i, at, labels.get(i), i in frame.states);
    }
  }

  // The corner of a label: right above its hull, or beside it where no border, link or label is; where it was if that is as good.
  corner(i, x, y, wide) {
    const corners = [[14, -26], [-14 - wide, -26], [14, 9], [-14 - wide, 9]].map(([dx, dy]) => [x + dx, y + dy]);
    const lanes = this.setup.many ? [] : this.lanes.filter(Boolean);
    const costs = corners.map(([left, top]) => {
      const cut = left < 0 || left + wide > this.width || top < 0 || top + LABEL_PX > this.height;
      const over = lanes.filter((lane) => [0, 1 / 3, 2 / 3, 1].some((share) => distanceToLane(left + share * wide, top + LABEL_PX / 2, lane) < LABEL_PX / 2));
      const others = this.boxes.filter(([a, b, w]) => Math.abs(b - top) < LABEL_PX && a < left + wide && left < a + w);
      return (cut ? 100 : 0) + over.length + 2 * others.length;
    });
    const last = this.corners.get(i) ?? 0;
    const least = Math.min(...costs);
    const k = costs[last] === least ? last : costs.indexOf(least);
    this.corners.set(i, k);
    this.boxes.push([...corners[k], wide]);
    return corners[k];
  }

  drawLabel(i, at, [name, depth], ill) {
    const { g } = this;
    g.textBaseline = "middle";
    g.font = "11px system-ui, sans-serif";
    const more = depth ? g.measureText(depth).width + 7 : 0;
    g.font = "600 12px system-ui, sans-serif";
    const wide = g.measureText(name).width + 10;
    const [left, top] = this.corner(i, at[0], at[1], wide + more);
    g.fillStyle = ill ? "rgba(110, 20, 35, 0.9)" : "rgba(4, 14, 26, 0.75)";
    g.beginPath();
    g.roundRect(left, top, wide, LABEL_PX, 5);
    g.fill();
    g.fillStyle = ill ? "#ffffff" : hull(i);
    g.fillText(name, left + 5, top + 9);
    if (depth) {
      g.font = "11px system-ui, sans-serif";
      g.fillStyle = "rgba(4, 14, 26, 0.6)"; // a link may lie below
      g.fillRect(left + 1 + wide, top, more - 1, LABEL_PX);
      g.fillStyle = "rgba(205, 225, 245, 0.85)";
      g.fillText(depth, left + 4 + wide, top + 9);
    }
    g.textBaseline = "alphabetic";
  }

  drawCompass(project) {
    const { g, camera, width, height } = this;
    const origin = project(camera.centre);
    const [n0, e0, d0] = camera.centre;
    const north = project([n0 + camera.radius, e0, d0]);
    const turn = Math.atan2(north[1] - origin[1], north[0] - origin[0]);
    const [x, y] = [width - 42, height - 44];
    g.strokeStyle = g.fillStyle = "rgba(220, 235, 250, 0.9)";
    g.lineWidth = 2;
    const tip = [x + 18 * Math.cos(turn), y + 18 * Math.sin(turn)];
    g.beginPath();
    g.moveTo(x - 14 * Math.cos(turn), y - 14 * Math.sin(turn));
    g.lineTo(...tip);
    g.stroke();
    this.drawTip([[x, y], tip], 9);
    g.font = "600 11px system-ui, sans-serif";
    g.textAlign = "center";
    g.fillText("N", x + 28 * Math.cos(turn), y + 28 * Math.sin(turn) + 4);
    g.font = "11px system-ui, sans-serif";
    g.textAlign = "right";
    g.fillText(`grid ${this.step} m`, width - 12, height - 8);
    g.textAlign = "left";
  }

  drawLine() {
    const { g, line } = this;
    g.strokeStyle = "#ff5c6c";
    g.lineWidth = 3;
    g.setLineDash([8, 5]);
    g.beginPath();
    g.moveTo(...line[0]);
    g.lineTo(...line[1]);
    g.stroke();
    g.setLineDash([]);
  }

  // What is under a point of the canvas: a vehicle, or else a link, or else nothing.
  under(x, y) {
    const near = this.spots
      .map((spot) => ({ vehicle: spot.i, away: Math.hypot(spot.x - x, spot.y - y) }))
      .filter(({ away }) => away < HULL_PX)
      .sort((a, b) => a.away - b.away)[0];
    if (near) return near;
    return this.lanes
      .map((ends, link) => ({ link, away: ends ? distanceToLane(x, y, ends) : Infinity }))
      .filter(({ away }) => away < LINK_PX)
      .sort((a, b) => a.away - b.away)[0];
  }

  listen() {
    const { canvas, camera } = this;
    const place = (event) => [event.offsetX, event.offsetY];
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held = { from: place(event), last: place(event), moved: false };
      if (this.drawing) this.line = [place(event), place(event)];
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = place(event);
      if (held && this.line) this.line[1] = [x, y];
      else if (held) {
        held.moved ||= Math.hypot(x - held.from[0], y - held.from[1]) > 4;
        if (held.moved) camera.turn(-(x - held.last[0]) / 180, (y - held.last[1]) / 180);
        held.last = [x, y];
      } else this.hover(x, y);
      this.dirty = true;
    });
    canvas.addEventListener("pointerup", (event) => {
      const [x, y] = place(event);
      if (this.line) this.divide();
      else if (held && !held.moved) this.click(this.under(x, y));
      held = null;
      this.dirty = true;
    });
    canvas.addEventListener("pointerleave", () => this.hover(-1e6, -1e6));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        camera.magnify(Math.exp(-event.deltaY / 500));
        this.dirty = true;
      },
      { passive: false },
    );
    const keys = {
      ArrowLeft: () => camera.turn(-0.1, 0),
      ArrowRight: () => camera.turn(0.1, 0),
      ArrowUp: () => camera.turn(0, 0.1),
      ArrowDown: () => camera.turn(0, -0.1),
      "+": () => camera.magnify(1.2),
      "-": () => camera.magnify(1 / 1.2),
      0: () => camera.reset(),
      t: () => this.onView?.(),
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey || !(event.key in keys)) return;
      event.preventDefault();
      keys[event.key]();
      this.dirty = true;
    });
  }

  click(found) {
    if (found?.vehicle) this.handlers.onVehicle(found.vehicle);
    else if (found) this.handlers.onLink(...this.setup.links[found.link]);
    else this.handlers.onVehicle(0);
  }

  hover(x, y) {
    const found = this.under(x, y) ?? null;
    this.over = found;
    this.canvas.style.cursor = this.drawing ? "crosshair" : found ? "pointer" : "grab";
    this.tip.hidden = !found;
    this.dirty = true;
    if (!found || !this.now) return;
    this.tip.textContent = found.vehicle ? this.vehicleTip(found.vehicle) : this.linkTip(found.link);
    this.tip.style.left = `${Math.min(x + 14, this.width - 250)}px`;
    this.tip.style.top = `${y + 14}px`;
  }

  vehicleTip(i) {
    const { errors, states } = this.now.frame;
    const error = errors[i - 1];
    const off = this.setup.guided ? `${error == null ? "-" : `${error.toFixed(2)} m`} off its place` : this.setup.moored ? "moored" : "";
    const name = this.setup.names[i - 1];
    return [/^\d/.test(name) ? `vehicle ${name}` : name, [off, states[i]].filter(Boolean).join(", ")].filter(Boolean).join(": ");
  }

  linkTip(k) {
    const [src, dst] = this.setup.links[k];
    const { links, ages, since } = this.now.frame;
    const [from, to] = [this.setup.names[src - 1], this.setup.names[dst - 1]];
    return `link ${from} -> ${to}: ${LINKS[links[k]].says}; what ${to} knows of ${from} is ${old(ages[k], since)}`;
  }

  divide() {
    const [a, b] = this.line;
    this.line = null;
    this.drawing = false;
    const groups = [[], []];
    for (const { i, x, y } of this.spots) groups[isLeft([x, y], a, b) ? 0 : 1].push(i);
    for (const group of groups) group.sort((p, q) => p - q);
    this.handlers.onLine(groups);
  }
}
