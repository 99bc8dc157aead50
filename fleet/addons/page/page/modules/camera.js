// A camera that orbits the fleet, and the projection from north-east-down [m] to pixels.
const HALF_PI = Math.PI / 2;
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

export class Camera {
  azimuth = -0.6; // [rad] of the view, 0: north is up
  elevation = 0.5; // [rad] above the horizon, pi/2: from above
  zoom = 1;
  centre = [0, 0, 0];
  radius = 10; // [m] of what must be seen
  #turned = { azimuth: -0.6, elevation: 0.5 };
  #known = false;

  get above() {
    return this.elevation > HALF_PI - 1e-3;
  }

  fromAbove(yes) {
    if (yes === this.above) return;
    if (yes) {
      this.#turned = { azimuth: this.azimuth, elevation: this.elevation };
      [this.azimuth, this.elevation] = [0, HALF_PI];
    } else {
      ({ azimuth: this.azimuth, elevation: this.elevation } = this.#turned);
    }
  }

  turn(dx, dy) {
    if (this.above) {
      this.azimuth += dx;
      return;
    }
    this.azimuth += dx;
    this.elevation = clamp(this.elevation + dy, 0.05, HALF_PI - 0.05);
  }

  magnify(factor) {
    this.zoom = clamp(this.zoom * factor, 0.1, 40);
  }

  reset() {
    this.zoom = 1;
    if (!this.above) [this.azimuth, this.elevation] = [-0.6, 0.5];
    else this.azimuth = 0;
  }

  // What comes next is of another time: it is brought into sight at once.
  jump() {
    this.#known = false;
  }

  // Follow points so that they stay in sight; smoothly, but at once the first time or after a jump.
  follow(points, share = 0.08) {
    if (!points.length) return;
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (const point of points) {
      for (let k = 0; k < 3; k++) {
        low[k] = Math.min(low[k], point[k]);
        high[k] = Math.max(high[k], point[k]);
      }
    }
    const centre = low.map((value, k) => (value + high[k]) / 2);
    const radius = Math.max(2, Math.hypot(...high.map((value, k) => (value - low[k]) / 2)));
    const far = Math.hypot(...centre.map((value, k) => value - this.centre[k])) > 3 * this.radius;
    const part = !this.#known || far ? 1 : share;
    this.#known = true;
    this.centre = this.centre.map((value, k) => value + part * (centre[k] - value));
    this.radius += part * (radius - this.radius);
  }

  // The projection for a canvas of this size: a function from a place to [x, y, depth], and pixels per metre.
  projection(width, height) {
    const scale = (this.zoom * 0.4 * Math.min(width, height * 1.25)) / this.radius;
    const [n0, e0, d0] = this.centre;
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const distance = 7 * this.radius;
    const [x0, y0] = [width / 2, height / 2];
    const project = (place) => {
      const [n, e, up] = [place[0] - n0, place[1] - e0, d0 - place[2]];
      const right = ca * e + sa * n;
      const away = ca * n - sa * e;
      const depth = away * ce - up * se;
      const near = distance / Math.max(0.2 * distance, distance + depth);
      return [x0 + scale * near * right, y0 - scale * near * (away * se + up * ce), depth];
    };
    return { project, scale };
  }
}
