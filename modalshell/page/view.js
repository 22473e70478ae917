// ---- what all pages share: camera, pointer, keys, the link of a state, light and dark ----
const camera = {azimuth: -1.0, elevation: 0.45, distance: 1.6 * data.size, centre: [0, 0, 0]};

function axes() {  // right, up, and the direction towards the eye
  const a = camera.azimuth, e = camera.elevation;
  const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
  return [[-Math.sin(a), Math.cos(a), 0], [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)], back];
}
function cameraMatrix() {  // by columns
  const [right, up, back] = axes(), d = camera.distance, c = camera.centre;
  const near = 0.02 * d, far = d + 6 * data.size, aspect = canvas.width / canvas.height;
  const dot = v => v[0] * c[0] + v[1] * c[1] + v[2] * c[2];
  const a = (far + near) / (near - far), b = 2 * far * near / (near - far), out = [];
  for (let i = 0; i < 3; i++) out.push(FOCUS / aspect * right[i], FOCUS * up[i], a * back[i], -back[i]);
  out.push(-FOCUS / aspect * dot(right), -FOCUS * dot(up), -a * (dot(back) + d) + b, dot(back) + d);
  return out;
}
function projected(x) {  // place in the picture [pixels], pixels a metre there, depth
  const [right, up, back] = axes(), c = camera.centre, r = [x[0] - c[0], x[1] - c[1], x[2] - c[2]];
  const dot = v => v[0] * r[0] + v[1] * r[1] + v[2] * r[2], depth = camera.distance - dot(back);
  const half = view.clientHeight / 2, unit = FOCUS * half / depth;
  return [view.clientWidth / 2 + unit * dot(right), half - unit * dot(up), unit, depth];
}
function nearestPoint(x, stride, px, py) {  // the point that is seen nearest to a pixel, none beyond 30 pixels
  let best = -1, nearest = 30 ** 2;
  for (let i = 0; stride * i < x.length; i++) {
    const at = projected(x.subarray(stride * i, stride * i + 3)), d = (at[0] - px) ** 2 + (at[1] - py) ** 2;
    if (d < nearest) { nearest = d; best = i; }
  }
  return best;
}

function distanceFor(x, stride = 3) {  // from which every point is in the picture, with a margin
  const [right, up, back] = axes(), c = camera.centre, aspect = view.clientWidth / view.clientHeight || 1;
  let need = 0;
  for (let i = 0; i + 2 < x.length; i += stride) {
    const r = [x[i] - c[0], x[i + 1] - c[1], x[i + 2] - c[2]], dot = v => v[0] * r[0] + v[1] * r[1] + v[2] * r[2];
    need = Math.max(need, dot(back) + FOCUS / 0.88 * Math.max(Math.abs(dot(right)) / aspect, Math.abs(dot(up))));
  }
  return need;
}
// The camera frames `framing.points()` until the reader zooms, and draws back where what moves would leave the picture.
const framing = {on: false, points: () => [], stride: 3};
function frameAll() {
  framing.on = true;
  const x = framing.points();
  if (x.length) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i + 2 < x.length; i += framing.stride) for (let a = 0; a < 3; a++) {
      low[a] = Math.min(low[a], x[i + a]); high[a] = Math.max(high[a], x[i + a]);
    }
    camera.centre = low.map((value, a) => 0.5 * (value + high[a]));
    camera.distance = Math.max(distanceFor(x, framing.stride), 0.05 * data.size);
  }
}
function keepFramed(x) {
  if (framing.on && x.every(Number.isFinite)) camera.distance = Math.max(camera.distance, distanceFor(x, framing.stride));
}
function turn(azimuth, elevation) {
  camera.azimuth += azimuth;
  camera.elevation = Math.max(-1.55, Math.min(1.55, camera.elevation + elevation));
  if (framing.on) frameAll();
}
function zoom(factor) {
  framing.on = false;
  camera.distance = Math.max(0.3 * data.size, Math.min(20 * data.size, camera.distance * factor));
}
function pan(dx, dy) {  // by pixels
  const [right, up] = axes(), unit = 2 * camera.distance / (FOCUS * view.clientHeight);
  framing.on = false;
  camera.centre = camera.centre.map((value, a) => value - unit * (dx * right[a] - dy * up[a]));
}

function pointer({press = () => false, drag = () => {}, drop = () => {}}) {  // turn; two fingers zoom; press may take a point
  const down = new Map();
  let held = false;
  const spread = () => {
    const [a, b] = [...down.values()];
    return {far: Math.hypot(a[0] - b[0], a[1] - b[1]) || 1, middle: [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]};
  };
  canvas.onpointerdown = event => {
    canvas.setPointerCapture(event.pointerId);
    if (held) { drop(); held = false; }
    down.set(event.pointerId, [event.offsetX, event.offsetY]);
    held = down.size === 1 && press(event.offsetX, event.offsetY);
  };
  canvas.onpointermove = event => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const here = [event.offsetX, event.offsetY];
    if (down.size === 2) {
      const old = spread();
      down.set(event.pointerId, here);
      const now = spread();
      zoom(old.far / now.far);
      pan(now.middle[0] - old.middle[0], now.middle[1] - old.middle[1]);
      return;
    }
    down.set(event.pointerId, here);
    if (held) drag(...here);
    else if (event.shiftKey) pan(here[0] - before[0], here[1] - before[1]);
    else turn(-0.008 * (here[0] - before[0]), 0.008 * (here[1] - before[1]));
  };
  canvas.onpointerup = canvas.onpointercancel = event => {
    if (held) drop();
    held = false;
    down.delete(event.pointerId);
  };
  canvas.addEventListener("wheel", event => { event.preventDefault(); zoom(Math.exp(0.001 * event.deltaY)); }, {passive: false});
}

// ---- light and dark ----
const wish = matchMedia("(prefers-color-scheme: dark)");
let tint = [1, 1, 1];
const backdrop = () => tint;
function paintTheme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  const found = getComputedStyle(document.body).backgroundColor.match(/\d+/g) || [255, 255, 255];
  tint = found.slice(0, 3).map(value => value / 255);
  show("theme", dark ? "Light" : "Dark");
}
const isDark = () => document.documentElement.dataset.theme === "dark";

// ---- the link of a state: numbers after the address's # ----
const digits = list => [...list].map(value => +value.toPrecision(6)).join(",");
function link(parts) {
  const all = {...parts, azimuth: digits([camera.azimuth]), elevation: digits([camera.elevation])};
  if (!framing.on) { all.distance = digits([camera.distance]); all.centre = digits(camera.centre); }
  return Object.entries(all).map(([name, value]) => `${name}=${encodeURIComponent(value)}`).join("&");
}
function linked() {  // what the address holds: text, and lists of numbers that are numbers
  const words = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  const numbers = (name, count) => {
    const list = (words[name] || "").split(",").map(Number);
    return words[name] && list.length === count && list.every(Number.isFinite) ? list : null;
  };
  return {words, numbers};
}
function restoreCamera() {
  const {numbers} = linked();
  for (const name of ["azimuth", "elevation"]) if (numbers(name, 1)) camera[name] = numbers(name, 1)[0];
  if (framing.on) frameAll();
  if (numbers("distance", 1) && numbers("centre", 3)) {
    framing.on = false;
    camera.distance = Math.max(0.05 * data.size, Math.abs(numbers("distance", 1)[0])); camera.centre = numbers("centre", 3);
  }
}

// ---- the controls that all pages have, and the first frame ----
function connectPage({parts = () => ({}), keys = {}}) {
  paintTheme(wish.matches);
  wish.onchange = event => paintTheme(event.matches);
  element("theme").onclick = () => paintTheme(!isDark());
  element("fit").onclick = frameAll;
  element("fit").hidden = !framing.on;
  element("link").onclick = () => {
    location.hash = link(parts());
    show("said", "The address of this page now holds what is shown: copy it.");
    if (navigator.clipboard) navigator.clipboard.writeText(location.href).then(() => show("said", "Link copied."), () => {});
  };
  const fold = open => { element("rest").hidden = !open; element("fold").setAttribute("aria-expanded", open); show("fold", open ? "Less" : "More"); };
  element("fold").onclick = () => fold(element("rest").hidden);
  fold(!matchMedia("(max-width: 640px)").matches);
  const moves = {
    " ": () => element("pause").click(), f: frameAll, d: () => element("theme").click(), l: () => element("link").click(),
    "+": () => zoom(0.9), "-": () => zoom(1 / 0.9), ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
    ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1), ...keys,
  };
  addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, button, a")) return;
    if (!moves[event.key]) return;
    event.preventDefault();
    moves[event.key]();
  });
  new ResizeObserver(() => { if (framing.on) frameAll(); }).observe(view);
}
function start(tick) {  // the canvas in place of the picture, and the first frame
  element("picture").remove(); element("missing").remove();
  element("bar").hidden = element("controls").hidden = false;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", document.title + ": drawing, turned by the arrow keys");
  view.appendChild(canvas);
  if (framing.on) frameAll();
  restoreCamera();
  requestAnimationFrame(tick);
}
