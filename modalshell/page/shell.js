// ---- drawing: the warp runs in the vertex shader ----
const VERTEX = WARP + `
uniform sampler2D table; uniform float q[${2 * m + r}]; uniform mat4 camera; uniform bool warp;
in vec3 rest; out vec3 place;
vec3 entry(int at) { return texelFetch(table, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0).xyz; }
void main() {
  vec3 u = vec3(0.0), w = vec3(0.0);
  for (int k = 0; k < ${m}; k++) {
    u += q[k] * entry(k * ${n} + gl_VertexID);
    if (warp) w += q[${m} + k] * entry((${m} + k) * ${n} + gl_VertexID);
  }
  for (int k = ${2 * m}; k < ${2 * m + r}; k++) u += q[k] * entry(k * ${n} + gl_VertexID);
  place = rest + warped(u, w);
  gl_Position = camera * vec4(place, 1.0);
}`;
let drawn = null, mesh = null, table = null;
function prepare() {
  if (scene) scenePrograms();
  if (!live) return;
  drawn = program(VERTEX, SHADED);
  table = modalTexture([live.phi, live.psi, ...(reduced ? [reduced.shapes] : [])].map(halves), n);
  mesh = surface(drawn.made, rest, faces);
}
function place(x) {  // where parts that fly in their frames are
  const at = gl.getAttribLocation(drawn.made, "rest");
  gl.bindVertexArray(mesh);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.getVertexAttrib(at, gl.VERTEX_ATTRIB_ARRAY_BUFFER_BINDING));
  gl.bufferData(gl.ARRAY_BUFFER, Float32Array.from(x), gl.DYNAMIC_DRAW);
}
function shownCoordinates() {
  if (state.shown < 0) return state.q;
  const q = new Float64Array(m), swing = Math.sin(2 * performance.now() / 1000);
  q[state.shown] = live.amplitudes[state.shown] * element("amplitude").value * swing;
  return q;
}
function draw(q) {
  if (state.model === "scene") { drawScene(); return; }
  clear();
  const scaled = new Float32Array(2 * m + r);
  if (!free) for (let k = 0; k < m; k++) { scaled[k] = q[k] * live.phi.scales[k]; scaled[m + k] = q[k] * live.psi.scales[k]; }
  bend(q);
  if (free) place(positions(q));
  else if (state.model === "rsw") for (let k = 0; k < r; k++) scaled[2 * m + k] = bent[k] * reduced.shapes.scales[k];
  gl.useProgram(drawn.made);
  gl.bindVertexArray(mesh);
  bind(drawn.places, {table});
  gl.uniform1fv(drawn.places.q, scaled);
  gl.uniform1i(drawn.places.warp, state.model === "mwts");
  gl.uniformMatrix4fv(drawn.places.camera, false, cameraMatrix());
  gl.uniform3fv(drawn.places.towards, axes()[2]);
  gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
}

// ---- controls ----
function numbers(q) {
  const x = positions(q);
  let largest = 0;
  for (let i = 0; i < n; i++)
    largest = Math.max(largest, Math.hypot(x[3 * i] - rest[3 * i], x[3 * i + 1] - rest[3 * i + 1], x[3 * i + 2] - rest[3 * i + 2]));
  const g = state.gravity, weight = Math.hypot(...g) || 1, down = weight === 1 && !g.some(Boolean) ? [0, 0, -1] : g.map(a => a / weight);
  let drop = 0;
  for (let a = 0; a < 3; a++) drop += down[a] * (x[3 * data.tip + a] - rest[3 * data.tip + a]);
  const change = area(x) / restArea - 1;
  show("time", timeNow()); show("drop", length(drop)); show("largest", length(largest));
  show("area", fixed(100 * change, 2) + " %");
  if (live) bars(q);
  keepFramed(x);
  return {drop, largest, area: change};
}
function bars(q) {
  const reach = Math.max(...live.amplitudes.map((a, k) => Math.abs(q[k]) / a), 1);
  [...element("bars").children].forEach((bar, k) => {
    const share = q[k] / live.amplitudes[k] / reach, span = bar.firstChild;
    span.style.top = (share > 0 ? 50 - 50 * share : 50) + "%";
    span.style.height = Math.abs(50 * share) + "%";
    bar.className = (k >= state.count ? "off" : "") + (k === state.shown ? " chosen" : "");
  });
}
function aim() {
  const g = +element("gravity").value, a = element("azimuth").value * Math.PI / 180, e = element("elevation").value * Math.PI / 180;
  state.gravity = [g * Math.cos(e) * Math.cos(a), g * Math.cos(e) * Math.sin(a), g * Math.sin(e)];
  labels();
}
function labels() {
  const played = state.model === "scene";
  show("count_value", state.count); show("gravity_value", short(+element("gravity").value));
  show("azimuth_value", element("azimuth").value + "°"); show("elevation_value", element("elevation").value + "°");
  show("damping_value", short(state.xi)); show("pause", state.paused ? "Play" : "Pause");
  element("amplitude_label").hidden = state.shown < 0;
  show("shape", state.shown < 0 ? "Press a bar to see a mode by itself; press it again to go on."
       : `Mode ${state.shown + 1}: ${live.frequencies[state.shown].toPrecision(4)} ${data.units.frequency}`);
  for (const part of document.querySelectorAll(".model")) part.hidden = played;
  for (const part of document.querySelectorAll(".clip")) part.hidden = !played || still;
  element("scale").hidden = !(played && scene.tones);
  element("pause").hidden = element("time_row").hidden = played && still;
  element("model").value = state.model;
}
function short(value) { return String(+value.toPrecision(3)); }
function timeNow() {  // to a hundredth of what is played
  const span = state.model === "scene" && !still ? scene.times[scene.times.length - 1] - scene.times[0] : 1;
  const slow = state.model === "scene" && slowed > 1 ? `, slowed ${slowed} times` : "";
  return `${state.time.toFixed(Math.max(2, Math.ceil(2 - Math.log10(span))))} ${data.units.time}${slow}${barNow()}`;
}
function fixed(value, digits) {  // without the sign of a zero
  return (Math.round(value * 10 ** digits) / 10 ** digits + 0).toFixed(digits);
}
function length(value) {  // to a ten-thousandth of the shell's size at least
  const digits = size => Math.max(2, Math.ceil(4 - Math.log10(size)));
  if (data.units.length !== "m") return `${fixed(value, digits(data.size))} ${data.units.length}`;
  return Math.abs(value) >= 0.1 ? value.toFixed(3) + " m" : `${fixed(1000 * value, digits(1000 * data.size))} mm`;
}
function choose(model) {  // the stored motion, or a live model, which begins at rest after it
  if ((model === "scene") !== (state.model === "scene")) { release(); state.shown = -1; }
  state.model = model;
  if (model === "scene") { state.time = scene.times[0]; playAt(state.time); }
  known = false;
  labels();
  if (framing.on) frameAll();
}
function direct(g) {  // the sliders of gravity
  const size = Math.hypot(...g);
  element("gravity").value = size;
  element("azimuth").value = Math.round(Math.atan2(g[1], g[0]) * 180 / Math.PI);
  element("elevation").value = size ? Math.round(Math.asin(g[2] / size) * 180 / Math.PI) : -90;
}
function connectModel() {
  const peak = 2 * Math.max(data.earth, Math.hypot(...data.gravity));
  element("count").max = m; element("count").value = m;
  element("gravity").max = peak; element("damping").max = 10 / data.second;
  direct(data.gravity);
  element("damping").value = state.xi;
  element("release").onclick = () => { release(); state.shown = -1; state.paused = false; labels(); };
  element("settle").onclick = () => { show("shape", settle() ? "Settled." : "It does not settle: no static shape near here."); };
  element("count").oninput = event => { state.count = +event.target.value; known = false; labels(); };
  for (const name of ["gravity", "azimuth", "elevation"]) element(name).oninput = aim;
  element("damping").oninput = event => { state.xi = +event.target.value; labels(); };
  for (let k = 0; k < m; k++) {
    const bar = document.createElement("button");
    bar.appendChild(document.createElement("span"));
    bar.title = `mode ${k + 1}, ${live.frequencies[k].toPrecision(4)} ${data.units.frequency}`;
    bar.setAttribute("aria-label", bar.title);
    bar.onclick = () => { state.shown = state.shown === k ? -1 : k; labels(); };
    element("bars").appendChild(bar);
  }
}
function connect() {
  const offered = {scene: scene, mwts: live, lma: live, rsw: reduced};
  for (const [name, there] of Object.entries(offered)) if (!there) element("model").querySelector(`[value=${name}]`).remove();
  element("model_label").hidden = element("model").length < 2;
  element("model").onchange = event => choose(event.target.value);
  element("pause").onclick = () => { state.paused = !state.paused; labels(); };
  if (live) connectModel();
  if (scene) {
    element("model").options[0].textContent = record.label;
    element("moment").min = scene.times[0]; element("moment").max = scene.times[scene.times.length - 1];
    element("moment").oninput = event => { state.time = +event.target.value; playAt(state.time); };
    showScale();
  }
  framing.on = true;
  framing.points = () => state.model === "scene" ? scenePoints() : rest;
  pointer({
    press: (x, y) => {
      const vertex = state.model !== "scene" && state.shown < 0 ? nearestPoint(positions(), 3, x, y) : -1;
      if (vertex < 0 || live.held.includes(vertex)) return false;
      state.pull = {vertex, force: [0, 0, 0], at: [x, y]};
      return true;
    },
    drag: (x, y) => { state.pull.at = [x, y]; },
    drop: () => { state.pull = null; },
  });
  if (scene) choose("scene");
  connectPage({
    parts: () => ({
      model: state.model, time: digits([state.time]), paused: +state.paused, count: state.count, shown: state.shown,
      ...(live ? {gravity: digits(state.gravity), damping: digits([state.xi]), q: digits(state.q), v: digits(state.v)} : {}),
    }),
    keys: {r: () => element("release").click(), s: () => element("settle").click(), ",": () => frames(-1), ".": () => frames(1)},
  });
  restore();
  labels();
}
function frames(count) {  // so many stored frames on
  if (state.model !== "scene" || still) return;
  const f = scene.times.findIndex(time => time >= state.time - 1e-9), last = scene.times.length - 1;
  state.paused = true;
  state.time = scene.times[Math.max(0, Math.min(last, (f < 0 ? last : f) + count))];
  element("moment").value = state.time;
  playAt(state.time);
  labels();
}
function restore() {  // what the address says
  const {words, numbers: given} = linked();
  if (words.model && [...element("model").options].some(one => one.value === words.model)) choose(words.model);
  if (given("time", 1)) state.time = given("time", 1)[0];
  if (state.model === "scene") { playAt(state.time); element("moment").value = state.time; }
  state.paused = words.paused === "1";
  if (!live) return;
  const count = given("count", 1), shown = given("shown", 1), q = given("q", m), v = given("v", m);
  if (count && count[0] >= 1 && count[0] <= m) { state.count = Math.round(count[0]); element("count").value = state.count; }
  if (shown && shown[0] < m) state.shown = Math.max(-1, Math.round(shown[0]));
  if (given("gravity", 3)) { state.gravity = given("gravity", 3); direct(state.gravity); }
  if (given("damping", 1)) { state.xi = Math.max(0, given("damping", 1)[0]); element("damping").value = state.xi; }
  if (q && v) { state.q.set(q); state.v.set(v); }
}
function pullAlong() {  // a spring from the vertex to the pointer, in the plane of the picture
  const x = new Float64Array(3), [right, up] = axes();
  if (free) x.set(vectorAt(positions(), state.pull.vertex));
  else { bend(state.q); position(state.pull.vertex, state.q, x); }
  const at = projected(x), dx = (state.pull.at[0] - at[0]) / at[2], dy = (at[1] - state.pull.at[1]) / at[2];
  for (let a = 0; a < 3; a++) state.pull.force[a] = live.pull * (dx * right[a] + dy * up[a]);
}
const slowed = data.slowed || 1;  // times, where the motion is too brief to be seen
let last = 0, owed = 0, cost = 0, frame = 0;
function tick(now) {
  const passed = last ? (now - last) / 1000 : 0;
  last = now;
  if (state.model === "scene" && !still && !state.paused) {
    const first = scene.times[0], span = scene.times[scene.times.length - 1] - first;
    state.time = first + (state.time - first + data.second * passed / slowed) % span;
    playAt(state.time);
    element("moment").value = state.time;
  }
  if (state.model !== "scene" && !state.paused && state.shown < 0) {
    owed = Math.min(owed + data.second * passed, 4 * live.dt);
    while (owed >= live.dt) {
      const begin = performance.now();
      if (state.pull) pullAlong();
      steps(1);
      cost = 0.9 * cost + 0.1 * (performance.now() - begin);
      owed -= live.dt;
    }
  }
  const q = shownCoordinates();
  draw(q);
  if (frame++ % 6 === 0) { numbers(q); show("cost", cost.toFixed(3) + " ms"); }
  requestAnimationFrame(tick);
}
window.shell = {  // for scripts and tests
  state, camera, steps, playAt, settle, release, numbers, choose, scene,
  screen: i => projected(positions().subarray(3 * i, 3 * i + 3)).slice(0, 2),
  positions: () => positions().map((x, i) => x + data.centre[i % 3]),
};
if (gl) {
  prepare();
  connect();
  start(tick);
}
