// The cell in three dimensions, on a plain canvas: arm, plate, spheres.
//
// The arm is drawn from its modified Denavit-Hartenberg table: each joint a drum
// about its axis, each link a tube along the row's two offsets. Polygons are
// shaded by their normal and painted from the back to the front.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const mul = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const size = a => Math.hypot(a[0], a[1], a[2]);
const unit = a => { const n = size(a) || 1; return mul(a, 1 / n); };
// A matrix is stored as its three columns, the axes of a frame.
const turn = (m, v) => add(add(mul(m[0], v[0]), mul(m[1], v[1])), mul(m[2], v[2]));

/** Frames of the joints at angles `q` (rad), base first: axes (columns) and origin (m). */
export function chain(joints, q) {
  const frames = [{ axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], at: [0, 0, 0] }];
  joints.forEach((j, k) => {
    const before = frames[k];
    const [sa, ca, sb, cb] = [Math.sin(j.alpha), Math.cos(j.alpha), Math.sin(j.beta), Math.cos(j.beta)];
    const angle = j.theta + (q[k] ?? 0);
    const [s, c] = [Math.sin(angle), Math.cos(angle)];
    // Rx(alpha) Ry(beta), then Rz(theta + q).
    const fixed = [[cb, sa * sb, -ca * sb], [0, ca, sa], [sb, -sa * cb, ca * cb]];
    const local = [add(mul(fixed[0], c), mul(fixed[1], s)), add(mul(fixed[0], -s), mul(fixed[1], c)), fixed[2]];
    const origin = add([j.a, 0, 0], mul(fixed[2], j.d));
    frames.push({
      axes: local.map(v => turn(before.axes, v)),
      at: add(before.at, turn(before.axes, origin)),
      // End of the offset along x, start of the offset along z.
      bend: add(before.at, mul(before.axes[0], j.a)),
    });
  });
  return frames;
}

/** The TCP (m) at angles `q`. */
export function tcp(scene, q) {
  const flange = chain(scene.joints, q).at(-1);
  return add(flange.at, turn(flange.axes, scene.tcp_m));
}

const SIDES = 26;

export class ArmView {
  constructor(canvas) {
    this.canvas = canvas;
    this.yaw = -0.85;
    this.pitch = 0.34;
    this.zoom = 1;
    this.scene = null;
    this.frame = null;
    this.q = [];
    this.dirty = true;
    this.colours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.colours());
    new ResizeObserver(() => { this.dirty = true; }).observe(canvas);
    this.hands();
  }

  /** Colours of the theme. */
  colours() {
    const style = getComputedStyle(document.documentElement);
    const rgb = name => {
      const text = style.getPropertyValue(name).trim();
      return [1, 3, 5].map(k => parseInt(text.slice(k, k + 2), 16));
    };
    this.colour = Object.fromEntries(["body", "drum", "tool", "plate", "steel", "good", "orange", "ground", "alarm"].map(n => [n, rgb(`--${n}`)]));
    this.shadow = style.getPropertyValue("--shadow").trim();
    this.dirty = true;
  }

  /** Mouse, fingers, keys. */
  hands() {
    const canvas = this.canvas;
    const by = (yaw, pitch) => {
      this.yaw -= yaw;
      this.pitch = Math.min(1.5, Math.max(-0.1, this.pitch + pitch));
      this.dirty = true;
    };
    const nearer = factor => {
      this.zoom = Math.min(4, Math.max(0.5, this.zoom * factor));
      this.dirty = true;
    };
    canvas.addEventListener("pointerdown", e => canvas.setPointerCapture(e.pointerId));
    canvas.addEventListener("pointermove", e => {
      if (canvas.hasPointerCapture(e.pointerId)) by(e.movementX * 0.008, e.movementY * 0.008);
    });
    canvas.addEventListener("wheel", e => { e.preventDefault(); nearer(Math.exp(-e.deltaY * 0.001)); }, { passive: false });
    canvas.addEventListener("keydown", e => {
      const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
      if (keys[e.key]) by(...keys[e.key]);
      else if (e.key === "+" || e.key === "=") nearer(1.15);
      else if (e.key === "-") nearer(1 / 1.15);
      else return;
      e.preventDefault();
    });
  }

  show(scene, frame, q) {
    this.scene = scene;
    this.frame = frame;
    this.q = q;
    this.dirty = true;
  }

  /** Where a point is seen: x, y in pixels, depth towards the eye, and scale. */
  project(p) {
    const d = sub(p, this.centre);
    const depth = dot(d, this.eye);
    const scale = this.focal / Math.max(0.2, this.away - depth);
    return [this.width / 2 + dot(d, this.right) * scale, this.height * 0.53 - dot(d, this.up) * scale, depth, scale];
  }

  /** Reach of the arm (m), with its pedestal. */
  reach() {
    return this.scene.joints.reduce((sum, j) => sum + Math.abs(j.a) + Math.abs(j.d), 0.05) + size(this.scene.tcp_m);
  }

  draw() {
    if (!this.dirty || !this.scene) return;
    this.dirty = false;
    const ratio = Math.min(2, devicePixelRatio || 1);
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    const [w, h] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (!w || !h) return;
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    const pen = (this.pen = this.canvas.getContext("2d"));
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, this.width, this.height);
    const [sy, cy, sp, cp] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    this.eye = [cp * cy, cp * sy, sp];
    this.right = [-sy, cy, 0];
    this.up = [-sp * cy, -sp * sy, cp];
    this.light = unit(add(add(mul(this.right, -0.5), mul(this.up, 0.9)), mul(this.eye, 0.55)));
    const reach = this.reach();
    this.centre = [0.19 * reach, 0, 0.27 * reach];
    this.away = 3.4 * reach;
    this.focal = (Math.min(this.width * 0.86, this.height * 1.02) / (0.86 * reach)) * this.away * 1.0 * this.zoom;
    this.polygons = [];
    this.drums = [];
    this.floor(reach);
    const tubes = this.arm(reach);
    this.plate(reach);
    this.shade(tubes);
    this.paint();
    this.arrow();
  }

  floor(reach) {
    const pen = this.pen;
    const step = reach > 1.6 ? 0.4 : 0.2;
    const n = Math.ceil((0.95 * reach) / step);
    pen.lineWidth = 1;
    pen.strokeStyle = `rgb(${this.colour.ground})`;
    pen.beginPath();
    for (let k = -n; k <= n; k += 1) {
      for (const [a, b] of [[[k * step, -n * step, 0], [k * step, n * step, 0]], [[-n * step, k * step, 0], [n * step, k * step, 0]]]) {
        const [from, to] = [this.project(a), this.project(b)];
        pen.moveTo(from[0], from[1]);
        pen.lineTo(to[0], to[1]);
      }
    }
    pen.stroke();
  }

  /** The arm's tubes and drums; returns its tubes for the shadow. */
  arm(reach) {
    const frames = chain(this.scene.joints, this.q);
    const last = frames.at(-1);
    const tip = add(last.at, turn(last.axes, this.scene.tcp_m));
    const tubes = [];
    const thick = k => reach * (0.052 - (0.022 * k) / frames.length);
    const tube = (a, b, r, colour, end = r) => {
      if (size(sub(b, a)) < 1e-4) return;
      tubes.push([a, b, r]);
      this.tube(a, b, r, end, colour);
    };
    // The inside of a drum is hidden, and not painted.
    for (let k = 1; k < frames.length; k += 1) this.drums.push([frames[k].at, frames[k].axes[2], thick(k) * 1.16, thick(k) * 1.15]);
    this.tube([0, 0, -0.002], [0, 0, 0.025 * reach], thick(0) * 1.75, thick(0) * 1.6, this.colour.tool, true);
    for (let k = 1; k < frames.length; k += 1) {
      const { at, bend, axes } = frames[k];
      tube(frames[k - 1].at, bend, thick(k - 1), this.colour.body, thick(k));
      tube(bend, at, thick(k), this.colour.body);
      const [, , half, round] = this.drums[k - 1];
      this.tube(sub(at, mul(axes[2], half)), add(at, mul(axes[2], half)), round, round, this.colour.drum, true);
    }
    // The tool: along the flange's axis first, then across; the nest at its end.
    const along = add(last.at, mul(last.axes[2], this.scene.tcp_m[2] - Math.sign(this.scene.tcp_m[2]) * 0.03));
    tube(last.at, along, thick(frames.length) * 0.62, this.colour.tool);
    const over = sub(tip, mul(last.axes[2], Math.sign(this.scene.tcp_m[2] || 1) * 0.03));
    tube(along, over, thick(frames.length) * 0.5, this.colour.tool);
    this.tube(over, tip, 0.016, 0.02, this.colour.orange, true);
    this.tip = tip;
    return tubes;
  }

  plate(reach) {
    const frame = this.frame;
    const sites = this.scene.sites;
    if (!sites.length) return;
    // The current placement is the one whose sphere is nearest to the tool.
    const near = sites.filter(s => frame && s.sphere === frame.sphere)
      .sort((a, b) => size(sub(a.at_m, this.tip)) - size(sub(b.at_m, this.tip)))[0];
    if (near && frame.sphere > 0) this.place = near.place;
    const here = sites.filter(s => s.place === (this.place ?? sites[0].place));
    const shown = here.length ? here : sites;
    const normal = mul(unit(shown[0].direction), -1);
    const middle = mul(shown.reduce((sum, s) => add(sum, s.at_m), [0, 0, 0]), 1 / shown.length);
    let x = shown.length > 1 ? sub(shown[1].at_m, shown[0].at_m) : [1, 0, 0];
    x = unit(sub(x, mul(normal, dot(x, normal))));
    const y = cross(normal, x);
    const ball = 0.0127, top = -0.03, thickness = 0.02, room = 0.05;
    const box = [x, y].map(axis => shown.map(s => dot(sub(s.at_m, middle), axis)));
    const [x0, x1] = [Math.min(...box[0]) - room, Math.max(...box[0]) + room];
    const [y0, y1] = [Math.min(...box[1]) - room, Math.max(...box[1]) + room];
    const at = (a, b, c) => add(middle, add(add(mul(x, a), mul(y, b)), mul(normal, c)));
    const side = (p, u, v, out) => this.sheet(p, u, v, out, this.colour.plate);
    side(at(x0, y0, top), mul(x, x1 - x0), mul(y, y1 - y0), normal);
    const down = mul(normal, -thickness);
    side(at(x0, y0, top), mul(x, x1 - x0), down, mul(y, -1));
    side(at(x0, y1, top), mul(x, x1 - x0), down, y);
    side(at(x0, y0, top), mul(y, y1 - y0), down, mul(x, -1));
    side(at(x1, y0, top), mul(y, y1 - y0), down, x);
    const foot = at((x0 + x1) / 2, (y0 + y1) / 2, top - thickness);
    if (foot[2] > 0.02) this.tube([foot[0], foot[1], 0], foot, 0.045, 0.035, this.colour.tool, true, 0.12);
    for (const site of shown) {
      const current = frame && frame.sphere === site.sphere;
      this.tube(add(site.at_m, mul(normal, top)), add(site.at_m, mul(normal, -ball)), 0.006, 0.006, this.colour.tool, true);
      this.ball(site.at_m, current ? ball * 1.25 : ball, current ? this.colour.orange : this.colour.steel);
    }
  }

  /** Whether the piece about a point is hidden in a drum, or in the floor; a drum's own pieces lie `deep`er in another. */
  inside(p, deep) {
    const room = 0.013;
    return p[2] < 0 || this.drums.some(([at, axis, half, round]) => {
      const d = sub(p, at);
      const along = dot(d, axis);
      const across = Math.sqrt(Math.max(0, dot(d, d) - along * along));
      return Math.abs(along) < half - room && across < round - (deep ? room : 0.001);
    });
  }

  /** One polygon with its normal, if it is seen. */
  polygon(points, normal, colour, bias = 0) {
    if (this.inside(mul(points.reduce(add), 1 / points.length), colour === this.colour.drum)) return;
    const seen = points.map(p => this.project(p));
    const [a, b, c] = seen;
    const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    const towards = this.away - bias;
    if (dot(normal, sub(add(this.centre, mul(this.eye, towards)), points[0])) <= 0 || Math.abs(area) < 1e-3) return;
    const shine = Math.max(0, dot(normal, this.light));
    const glint = Math.pow(shine, 14) * 38;
    const tone = colour.map(v => Math.min(255, Math.round(v * (0.5 + 0.52 * shine) + glint)));
    const depth = seen.reduce((sum, s) => sum + s[2], 0) / seen.length - bias;
    this.polygons.push([depth, seen, `rgb(${tone})`]);
  }

  /** A flat sheet in small pieces, so that it is painted in the right order. */
  sheet(corner, u, v, normal, colour) {
    const [n, m] = [u, v].map(e => Math.max(1, Math.ceil(size(e) / 0.05)));
    for (let i = 0; i < n; i += 1) {
      for (let j = 0; j < m; j += 1) {
        const at = (a, b) => add(corner, add(mul(u, a / n), mul(v, b / m)));
        this.polygon([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], normal, colour, 0.04);
      }
    }
  }

  /** A tube from `a` to `b`, with round ends or (`flat`) with lids; the larger its `bias`, the earlier it is painted. */
  tube(a, b, ra, rb, colour, flat = false, bias = 0) {
    const axis = unit(sub(b, a));
    const x = unit(cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
    const y = cross(axis, x);
    const rays = Array.from({ length: SIDES }, (_, k) => {
      const t = (2 * Math.PI * k) / SIDES;
      return add(mul(x, Math.cos(t)), mul(y, Math.sin(t)));
    });
    const rings = [];
    const cap = 4;
    if (!flat) for (let k = cap; k > 0; k -= 1) rings.push([add(a, mul(axis, -ra * Math.sin((k / cap) * 1.5))), ra * Math.cos((k / cap) * 1.5), -Math.sin((k / cap) * 1.5)]);
    const pieces = Math.max(1, Math.ceil(size(sub(b, a)) / 0.024));
    for (let k = 0; k <= pieces; k += 1) rings.push([add(a, mul(sub(b, a), k / pieces)), ra + ((rb - ra) * k) / pieces, 0]);
    if (!flat) for (let k = 1; k <= cap; k += 1) rings.push([add(b, mul(axis, rb * Math.sin((k / cap) * 1.5))), rb * Math.cos((k / cap) * 1.5), Math.sin((k / cap) * 1.5)]);
    for (let r = 0; r + 1 < rings.length; r += 1) {
      const [[p, rp, sp], [q, rq, sq]] = [rings[r], rings[r + 1]];
      for (let k = 0; k < SIDES; k += 1) {
        const [u, v] = [rays[k], rays[(k + 1) % SIDES]];
        const normal = unit(add(add(u, v), mul(axis, sp + sq)));
        this.polygon([add(p, mul(u, rp)), add(p, mul(v, rp)), add(q, mul(v, rq)), add(q, mul(u, rq))], normal, colour, bias);
      }
    }
    if (!flat) return;
    // Lids in small pieces, as sheets are.
    for (const [end, r, out] of [[a, ra, mul(axis, -1)], [b, rb, axis]]) {
      for (let k = 0; k < SIDES; k += 1) {
        const [u, v] = [rays[k], rays[(k + 1) % SIDES]].map(ray => mul(ray, r));
        const half = [u, v].map(e => mul(e, 0.55));
        this.polygon([end, add(end, half[0]), add(end, half[1])], out, colour, bias);
        this.polygon([add(end, half[0]), add(end, u), add(end, v), add(end, half[1])], out, colour, bias);
      }
    }
  }

  ball(at, radius, colour) {
    const rows = 8, columns = 12;
    const on = (i, j) => {
      const [t, f] = [(Math.PI * i) / rows, (2 * Math.PI * j) / columns];
      return [Math.sin(t) * Math.cos(f), Math.sin(t) * Math.sin(f), Math.cos(t)];
    };
    for (let i = 0; i < rows; i += 1) {
      for (let j = 0; j < columns; j += 1) {
        const corners = [on(i, j), on(i + 1, j), on(i + 1, j + 1), on(i, j + 1)];
        const normal = unit(corners.reduce(add, [0, 0, 0]));
        this.polygon(corners.map(c => add(at, mul(c, radius))), normal, colour);
      }
    }
  }

  /** The arm's shadow, straight down. */
  shade(tubes) {
    const pen = this.pen;
    pen.save();
    pen.strokeStyle = this.shadow;
    pen.lineCap = "round";
    pen.lineJoin = "round";
    pen.lineWidth = Math.max(2, tubes[0][2] * 1.7 * this.project([0, 0, 0])[3]);
    pen.beginPath();
    for (const [a, b] of tubes) {
      const [from, to] = [a, b].map(p => this.project([p[0], p[1], 0]));
      pen.moveTo(from[0], from[1]);
      pen.lineTo(to[0], to[1]);
    }
    pen.stroke();
    pen.restore();
  }

  paint() {
    const pen = this.pen;
    this.polygons.sort((a, b) => a[0] - b[0]);
    pen.lineWidth = 0.7;
    pen.lineJoin = "round";
    for (const [, seen, tone] of this.polygons) {
      pen.fillStyle = pen.strokeStyle = tone;
      pen.beginPath();
      pen.moveTo(seen[0][0], seen[0][1]);
      for (let k = 1; k < seen.length; k += 1) pen.lineTo(seen[k][0], seen[k][1]);
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  }

  /** The contact force at the tool, 2 cm for a newton. */
  arrow() {
    const force = this.frame?.force_n;
    if (!force || this.frame.force_is_vague || size(force) < 0.8) return;
    const pen = this.pen;
    const from = this.project(this.tip);
    const to = this.project(add(this.tip, mul(force, Math.min(0.02, 0.3 / size(force)))));
    const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    pen.strokeStyle = pen.fillStyle = `rgb(${this.colour.alarm})`;
    pen.lineWidth = 3;
    pen.beginPath();
    pen.moveTo(from[0], from[1]);
    pen.lineTo(to[0], to[1]);
    pen.stroke();
    pen.beginPath();
    pen.moveTo(to[0] + 6 * Math.cos(angle), to[1] + 6 * Math.sin(angle));
    for (const side of [2.4, -2.4]) pen.lineTo(to[0] + 7 * Math.cos(angle + side), to[1] + 7 * Math.sin(angle + side));
    pen.fill();
  }
}
