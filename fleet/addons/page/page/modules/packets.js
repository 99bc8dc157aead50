// Packets on their way, and sound that spreads: what became of a packet is known when it is, and shown then, slower
// than it was where the eye could not follow.
import { colour } from "./colours.js";
import { along } from "./geometry.js";

const MOST = 500; // at once

// A cross, in the colour and width of the context: something does not get through.
export function drawCross(g, x, y, half) {
  g.beginPath();
  g.moveTo(x - half, y - half);
  g.lineTo(x + half, y + half);
  g.moveTo(x - half, y + half);
  g.lineTo(x + half, y - half);
  g.stroke();
}

export class Packets {
  #flying = [];
  #rings = new Map();
  #setup;

  constructor(setup) {
    this.#setup = setup;
  }

  take(packets, rate, now) {
    const { links, acoustic, flight } = this.#setup;
    if (!packets.length) return;
    const first = Math.min(...packets.map(([, sent]) => sent));
    for (const [link, sent, late, fate] of packets) {
      const speed = Math.max(rate, 0.05) * 1000;
      const begins = now + Math.min(200, (1000 * (sent - first) * 1000) / speed);
      const lasts = 1000 * Math.min(flight.most_s, Math.max(flight.least_s, (1000 * late) / speed));
      this.#flying.push({ link, begins, ends: begins + lasts, fate });
      const src = links[link][0];
      if (acoustic && fate !== "cut") this.#rings.set(`${src} ${sent}`, { src, begins, ends: begins + lasts });
    }
    if (this.#flying.length > MOST) this.#flying.splice(0, this.#flying.length - MOST);
  }

  clear() {
    this.#flying = [];
    this.#rings.clear();
  }

  get moving() {
    return this.#flying.length > 0 || this.#rings.size > 0;
  }

  draw(g, lanes, now) {
    this.#flying = this.#flying.filter(({ ends }) => ends > now);
    for (const { link, begins, ends, fate } of this.#flying) {
      const lane = lanes[link];
      const share = (now - begins) / (ends - begins);
      if (share < 0 || !lane) continue;
      const stop = this.#setup.flight.stops[fate] ?? 1;
      const [x, y] = along(lane, Math.min(share, stop));
      g.globalAlpha = share > stop ? 1 - (share - stop) / (1 - stop) : 1;
      g.fillStyle = g.strokeStyle = colour(`packet ${fate}`);
      if (share > stop) {
        g.lineWidth = 1.8;
        drawCross(g, x, y, 4);
      } else {
        g.beginPath();
        g.arc(x, y, 3, 0, 7);
        g.fill();
      }
    }
    g.globalAlpha = 1;
  }

  // Circles on the sender's depth, as wide as the farthest place in sight at the end.
  drawRings(g, places, reach, project, now) {
    for (const [key, { src, begins, ends }] of this.#rings) {
      const share = (now - begins) / (ends - begins);
      if (share >= 1) this.#rings.delete(key);
      const place = places.get(src);
      if (share < 0 || share >= 1 || !place) continue;
      g.beginPath();
      for (let k = 0; k <= 36; k++) {
        const turn = (k * Math.PI) / 18;
        const radius = share * reach;
        const [x, y] = project([place[1] + radius * Math.cos(turn), place[2] + radius * Math.sin(turn), place[3]]);
        g.lineTo(x, y);
      }
      g.strokeStyle = `rgba(150, 220, 255, ${0.65 * (1 - share)})`;
      g.lineWidth = 2;
      g.stroke();
    }
  }
}
