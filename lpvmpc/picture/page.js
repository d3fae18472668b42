"use strict";
// One instant (`now`, in seconds) and one range of time go through all plots, maps and the film.

const D = JSON.parse(document.getElementById("data").textContent);
const $ = id => document.getElementById(id);

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}
const column = text => new Float32Array(bytes(text).buffer);
const pair = ([x, y]) => [column(x), column(y)];

const t = column(D.t), x = column(D.x), y = column(D.y), psi = column(D.psi), s = column(D.s);
const delta = column(D.delta), vx = column(D.vx), n = t.length;
const forces = D.forces.map(pair), horizon = D.horizon.map(pair);
const users = D.users.map(user => ({...user, pose: user.pose.map(column)}));
const first = t[0], last = t[n - 1];
let now = first, low = first, high = last;

function draw(name, attributes, text) {
  const e = document.createElementNS("http://www.w3.org/2000/svg", name);
  set(e, attributes);
  if (text !== undefined) e.textContent = text;
  return e;
}
function set(e, attributes) {
  for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
  return e;
}
function node(name, attributes, ...children) {
  const e = document.createElement(name);
  for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
  e.append(...children);
  return e;
}
function row(time) {  // the last instant that is not after a time
  let a = 0, b = n - 1;
  while (a < b) {
    const m = (a + b + 1) >> 1;
    if (t[m] <= time) a = m; else b = m - 1;
  }
  return a;
}
const fixed = (v, digits) => v.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1");  // no -0.00
const clip = (v, a, b) => Math.min(Math.max(v, a), b);

// Plots --------------------------------------------------------------------------------------
const LEFT = 48, RIGHT = 6, TOP = 6, BOTTOM = 18, TALL = 124;
const plots = D.plots.map(p => ({...p, curves: p.curves.map(c => ({...c, on: true,
  values: column(c.values)}))}));

function nice(a, b, count) {  // round numbers between a and b
  const raw = (b - a) / count, base = 10 ** Math.floor(Math.log10(raw));
  const step = base * [1, 2, 5, 10].find(k => k * base >= raw);
  const ticks = [];
  for (let k = Math.ceil(a / step - 1e-9); k * step <= b + 1e-9 * step; k++) ticks.push(k * step);
  return {ticks, digits: clip(-Math.floor(Math.log10(step) + 1e-9), 0, 6)};
}
for (const p of plots) {
  p.legend = node("span", {class: "legend"});
  for (const c of p.curves) {
    c.shown = node("span", {});
    const dot = node("span", {class: "dot", style: `background:${c.color || "var(--ink)"}`});
    const button = node("button", {type: "button", "aria-pressed": "true"}, dot, c.name + " ",
      c.shown);
    button.addEventListener("click", () => {
      c.on = !c.on;
      button.setAttribute("aria-pressed", String(c.on));
      curves(p);
    });
    p.legend.append(button);
  }
  p.svg = draw("svg", {role: "img", "aria-label": `${p.title} over time`});
  const title = node("b", {}, `${p.title} [${p.unit}]`);
  $("plots").append(node("div", {class: "plot"}, node("header", {}, title, p.legend), p.svg));
  listen(p);
}
function curves(p) {
  const W = Math.max(240, p.svg.clientWidth || 500), last_plot = p === plots[plots.length - 1];
  const H = TALL + (last_plot ? 16 : 0), X0 = LEFT, X1 = W - RIGHT, Y0 = TALL - BOTTOM, Y1 = TOP;
  const i0 = Math.max(0, row(low)), i1 = Math.min(n - 1, row(high) + 1);
  let a = Infinity, b = -Infinity;
  for (const c of p.curves) {
    if (!c.on) continue;
    for (let i = i0; i <= i1; i++) {
      const v = c.values[i];
      if (v < a) a = v;
      if (v > b) b = v;
    }
  }
  if (!(a <= b)) { a = -1; b = 1; }
  const room = 0.06 * (b - a) || 0.5 * Math.abs(a) || 1;
  a -= room; b += room;
  const X = time => X0 + (X1 - X0) * (time - low) / (high - low);
  const Y = v => Y0 + (Y1 - Y0) * (v - a) / (b - a);
  p.X = X; p.X0 = X0; p.X1 = X1;
  const parts = [];
  const time = nice(low, high, Math.max(2, W / 90)), value = nice(a, b, 4);
  for (const v of value.ticks) {
    parts.push(draw("line", {x1: X0, x2: X1, y1: Y(v), y2: Y(v),
      class: Math.abs(v) < 1e-12 ? "axis" : "grid"}));
    parts.push(draw("text", {x: X0 - 5, y: Y(v) + 4, "text-anchor": "end", class: "soft"},
      fixed(v, value.digits)));
  }
  for (const v of time.ticks) {
    parts.push(draw("line", {x1: X(v), x2: X(v), y1: Y0, y2: Y1, class: "grid"}));
    parts.push(draw("text", {x: X(v), y: Y0 + 14, "text-anchor": "middle", class: "soft"},
      v.toFixed(time.digits)));
  }
  if (last_plot) parts.push(draw("text", {x: (X0 + X1) / 2, y: H - 2, "text-anchor": "middle"},
    "time [s]"));
  for (const c of p.curves) {
    if (c.on) parts.push(draw("path", {d: line(c.values, i0, i1, X, Y, X1 - X0), fill: "none",
      stroke: c.color || "var(--ink)", "stroke-width": 1.4, "stroke-dasharray": c.dash,
      "stroke-linejoin": "round"}));
  }
  p.range = draw("rect", {y: Y1, height: Y0 - Y1, width: 0, fill: "var(--mark)", opacity: 0.18});
  p.cursor = draw("line", {y1: Y1, y2: Y0, stroke: "var(--mark)", "stroke-width": 1.2});
  set(p.svg, {viewBox: `0 0 ${W} ${H}`, height: H}).replaceChildren(...parts, p.range, p.cursor);
  cursor(p);
}
function line(values, i0, i1, X, Y, pixels) {
  // Of many instants in a pixel the lowest and the highest: a peak stays a peak.
  const bin = Math.max(1, Math.floor((i1 - i0 + 1) / (2 * pixels)));
  let path = "", gap = true;
  const put = i => {
    if (!Number.isFinite(values[i])) { gap = true; return; }
    const place = `${X(t[i]).toFixed(1)} ${Y(values[i]).toFixed(2)}`;
    path += (gap ? "M" : "L") + place;
    gap = false;
  };
  for (let i = i0; i <= i1; i += bin) {
    let a = i, b = i;
    for (let k = i + 1; k < Math.min(i + bin, i1 + 1); k++) {
      if (values[k] < values[a]) a = k;
      if (values[k] > values[b]) b = k;
    }
    put(Math.min(a, b));
    if (a !== b) put(Math.max(a, b));
  }
  return path || "M0 0";
}
function cursor(p) {
  const at = clip(p.X(now), -10, 1e5), seen = now >= low && now <= high, i = row(now);
  set(p.cursor, {x1: at, x2: at, visibility: seen ? "visible" : "hidden"});
  for (const c of p.curves) {
    const v = c.values[i];
    c.shown.textContent = Number.isFinite(v) ? fixed(v, p.digits) : "-";
  }
}
function listen(p) {
  let from = null;
  const time = event => {
    const box = p.svg.getBoundingClientRect();
    return clip(low + (high - low) * (event.clientX - box.left - p.X0) / (p.X1 - p.X0), low, high);
  };
  p.svg.addEventListener("pointerdown", event => {
    if (event.button) return;
    go(time(event));
    if (event.pointerType === "mouse") from = time(event);
    p.svg.setPointerCapture(event.pointerId);
  });
  p.svg.addEventListener("pointermove", event => {
    const at = time(event);
    if (!playing || event.buttons) go(at);
    if (from !== null) set(p.range, {x: p.X(Math.min(from, at)),
      width: Math.abs(p.X(at) - p.X(from))});
  });
  const end = event => {
    if (from === null) return;
    const a = Math.min(from, time(event)), b = Math.max(from, time(event));
    from = null;
    set(p.range, {width: 0});
    if (p.X(b) - p.X(a) > 8) range(a, b);
  };
  p.svg.addEventListener("pointerup", end);
  p.svg.addEventListener("pointercancel", () => { from = null; set(p.range, {width: 0}); });
  p.svg.addEventListener("dblclick", () => range(first, last));
}

// Map ----------------------------------------------------------------------------------------
const road = Object.fromEntries(Object.entries(D.road).map(([k, v]) => [k, column(v)]));
function chain(points) {
  let path = "";
  for (let i = 0; i < points.length; i += 2) {
    path += (i ? "L" : "M") + points[i].toFixed(2) + " " + points[i + 1].toFixed(2);
  }
  return path;
}
function backwards(points) {
  const out = new Float32Array(points.length);
  for (let i = 0; i < points.length; i += 2) {
    out[i] = points[points.length - 2 - i];
    out[i + 1] = points[points.length - 1 - i];
  }
  return out;
}
function driven(i0, i1, most) {
  const step = Math.max(1, Math.floor((i1 - i0) / most));
  let path = "";
  for (let i = i0; i <= i1; i += step) {
    if (Number.isFinite(x[i])) path += (path ? "L" : "M") + x[i].toFixed(3) + " " + y[i].toFixed(3);
  }
  return path || "M0 0";
}
const thin = {"vector-effect": "non-scaling-stroke", fill: "none"};
const surface = () => draw("path", {d: chain(road.left) + "L" + chain(backwards(road.right))
  .slice(1) + "Z", fill: "var(--line)", "fill-rule": "nonzero"});
const map = {};
function mapped() {
  let a = Infinity, b = -Infinity, c = Infinity, d = -Infinity;
  for (const points of [road.left, road.right]) {
    for (let i = 0; i < points.length; i += 2) {
      a = Math.min(a, points[i]); b = Math.max(b, points[i]);
      c = Math.min(c, points[i + 1]); d = Math.max(d, points[i + 1]);
    }
  }
  const edge = 0.04 * Math.max(b - a, d - c) + 4;
  a -= edge; b += edge; c -= edge; d += edge;
  const tall = clip((d - c) / (b - a), 0.16, 0.75);
  const more = Math.max(0, tall * (b - a) - (d - c)) / 2;
  c -= more; d += more;
  const world = draw("g", {transform: "scale(1,-1)"});
  const scale = Math.max(b - a, (d - c) / tall);
  map.all = draw("path", {d: driven(0, n - 1, 3000), ...thin, stroke: "var(--mark)",
    "stroke-width": 1});
  map.part = draw("path", {d: "M0 0", ...thin, stroke: "var(--mark)", "stroke-width": 3.5});
  map.car = draw("circle", {r: 0.016 * scale, fill: "#E69F00", stroke: "var(--ink)",
    "stroke-width": 1.5, "vector-effect": "non-scaling-stroke"});
  world.append(
    draw("path", {d: chain(road.centre), ...thin, stroke: "var(--line)", "stroke-width": 7}),
    surface(), map.all, map.part, map.car);
  const svg = set($("map"), {viewBox: `${a} ${-d} ${b - a} ${d - c}`});
  svg.replaceChildren(world);
  const pick = event => {
    if (!event.buttons) return;
    const p = new DOMPoint(event.clientX, event.clientY)
      .matrixTransform(world.getScreenCTM().inverse());
    let best = 0, least = Infinity;
    for (let i = 0; i < n; i++) {
      const far = (x[i] - p.x) ** 2 + (y[i] - p.y) ** 2;
      if (far < least) { least = far; best = i; }
    }
    go(t[best]);
  };
  svg.addEventListener("pointerdown", pick);
  svg.addEventListener("pointermove", pick);
}

// From above ---------------------------------------------------------------------------------
const near = {};
function above() {
  const {lf, lr, width} = D.car, half = width / 2;
  near.world = draw("g", {});
  const body = {x: -lr - 0.6, y: -half, width: lf + lr + 1.3, height: width, rx: 0.4};
  near.car = draw("g", {transform: "scale(1,-1)"});
  near.car.append(draw("rect", {...body, fill: "var(--back)", stroke: "var(--ink)",
    "stroke-width": 1.5, "vector-effect": "non-scaling-stroke", opacity: 0.92}));
  near.wheels = [[lf, half - 0.12], [lf, 0.12 - half], [-lr, half - 0.12], [-lr, 0.12 - half]];
  near.tires = near.wheels.map(() => draw("rect", {x: -0.32, y: -0.11, width: 0.64, height: 0.22,
    rx: 0.05, fill: "var(--ink)"}));
  near.arrows = near.wheels.map(() => draw("path", {...thin, stroke: "#D55E00",
    "stroke-width": 2.5}));
  near.car.append(...near.tires, ...near.arrows);
  near.ladder = draw("path", {...thin, stroke: "#E69F00", "stroke-width": 4,
    "stroke-linecap": "round"});
  near.driven = draw("path", {d: driven(0, n - 1, 1e9), ...thin, stroke: "var(--mark)",
    "stroke-width": 1.5});
  near.world.append(surface(),
    draw("path", {d: chain(road.left), ...thin, stroke: "var(--soft)", "stroke-width": 1.5}),
    draw("path", {d: chain(road.right), ...thin, stroke: "var(--soft)", "stroke-width": 1.5}),
    draw("path", {d: chain(road.centre), ...thin, stroke: "var(--soft)", "stroke-width": 1,
      "stroke-dasharray": "6 6"}), near.driven, near.ladder);
  for (const [cx, cy] of D.cones) near.world.append(draw("circle", {cx, cy, r: 0.2,
    fill: "#D55E00"}));
  near.users = users.map(({length, width}) => draw("rect", {x: -length / 2, y: -width / 2,
    width: length, height: width, rx: 0.3, fill: "var(--line)", stroke: "var(--ink)",
    "stroke-width": 1.5, "vector-effect": "non-scaling-stroke"}));
  near.world.append(...near.users);
  near.text = draw("text", {x: -11.4, y: -8, "font-size": 1.5, class: "soft"});
  set($("near"), {viewBox: "-12 -10 48 20"}).replaceChildren(near.world, near.car, near.text);
}
const degrees = angle => angle * 180 / Math.PI;
function place() {
  const i = row(now), k = Math.min(i + 1, n - 1);
  const w = k > i ? clip((now - t[i]) / (t[k] - t[i]), 0, 1) : 0;
  const between = values => (1 - w) * values[i] + w * values[k];
  const px = between(x), py = between(y);
  const turn = psi[k] - psi[i], angle = psi[i] + w * (turn - 2 * Math.PI * Math.round(turn / 2 / Math.PI));
  if (!Number.isFinite(px + py + angle)) return;
  set(near.world, {transform: `scale(1,-1) rotate(${-degrees(angle)}) translate(${-px},${-py})`});
  near.wheels.forEach(([a, b], wheel) => {
    const steer = wheel < 2 ? between(delta) : 0;
    set(near.tires[wheel], {transform: `translate(${a},${b}) rotate(${degrees(steer)})`});
    const [Fx, Fy] = forces[wheel].map(between);  // in the frame of the wheel
    const c = Math.cos(steer), q = Math.sin(steer), scale = 1e-3;
    const dx = scale * (c * Fx - q * Fy), dy = scale * (q * Fx + c * Fy);
    set(near.arrows[wheel], {d: Number.isFinite(dx + dy) ? `M${a} ${b}l${dx} ${dy}` : "M0 0"});
  });
  let ladder = "";
  for (const [hx, hy] of horizon) {
    if (Number.isFinite(hx[i])) ladder += (ladder ? "L" : "M") + `${hx[i]} ${hy[i]}`;
  }
  set(near.ladder, {d: ladder || "M0 0"});
  users.forEach(({pose: [ux, uy, turned]}, j) => set(near.users[j], {transform:
    `translate(${between(ux)},${between(uy)}) rotate(${degrees(turned[i])})`}));
  near.text.textContent = `${vx[i].toFixed(1)} m/s`;
  set(map.car, {cx: px, cy: py});
}

// Instant, range, play -----------------------------------------------------------------------
let playing = false, before = 0, awaited = false;
const film = $("film");
const hasFilm = $("film-data").textContent.length > 0;
if (hasFilm) {
  film.src = URL.createObjectURL(new Blob([bytes($("film-data").textContent)],
    {type: "video/mp4"}));
  film.hidden = false;
}
function show() {
  $("slider").value = String(1000 * (now - first) / (last - first || 1));
  $("clock").textContent = `${now.toFixed(2)} s, ${fixed(s[row(now)], 1)} m`;
  plots.forEach(cursor);
  place();
}
function go(time) {
  now = clip(time, first, last);
  if (hasFilm && !playing) seek();
  if (!awaited) requestAnimationFrame(() => { awaited = false; show(); });
  awaited = true;
}
function seek() {
  if (film.seeking) return;  // when it is there, the `seeked` below looks where we are by then
  const to = Math.min(now - first, (film.duration || 1e9) - 0.01);
  if (Math.abs(film.currentTime - to) > 0.02) film.currentTime = to;
}
film.addEventListener("seeked", () => { if (!playing) seek(); });
film.addEventListener("loadedmetadata", seek);
function range(a, b) {
  low = clip(a, first, last); high = clip(b, first, last);
  if (high - low < 0.2) high = Math.min(last, low + 0.2), low = Math.max(first, high - 0.2);
  set(map.part, {d: driven(row(low), row(high), 3000),
    visibility: low > first || high < last ? "visible" : "hidden"});
  plots.forEach(curves);
  show();
}
function zoom(factor) {
  const half = 0.5 * factor * (high - low), middle = clip(now, low, high);
  const a = clip(middle - half, first, Math.max(first, last - 2 * half));
  range(a, a + 2 * half);
}
function play(on) {
  playing = on;
  $("play").textContent = on ? "\u23f8\ufe0e" : "\u25b6\ufe0e";
  if (on && now >= last - 1e-3) now = first;
  before = performance.now();
  if (hasFilm) {
    film.playbackRate = +$("rate").value;
    film.currentTime = now - first;
    if (on) film.play().catch(() => {}); else film.pause();
  }
  if (on) requestAnimationFrame(tick);
}
function tick(time) {
  if (!playing) return;
  const filmed = hasFilm && !film.paused && !film.ended && film.readyState > 2;
  const rate = +$("rate").value;
  now = filmed ? first + film.currentTime : now + rate * Math.max(0, time - before) / 1000;
  before = time;
  if (now >= last || (hasFilm && film.ended)) { now = Math.min(now, last); play(false); }
  if (now > high || now < low) {  // turn the page
    const wide = high - low;
    const a = clip(now, first, last - wide);
    range(a, a + wide);
  }
  show();
  requestAnimationFrame(tick);
}
$("play").addEventListener("click", () => play(!playing));
$("rate").addEventListener("change", () => { film.playbackRate = +$("rate").value; });
$("slider").addEventListener("input", () => {
  go(first + $("slider").value / 1000 * (last - first));
  if (playing && hasFilm) film.currentTime = now - first;
});
$("in").addEventListener("click", () => zoom(0.5));
$("out").addEventListener("click", () => zoom(2));
$("all").addEventListener("click", () => range(first, last));
let waiting = 0;
addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(() =>
  plots.forEach(curves), 100); });
mapped();
above();
range(first, last);
