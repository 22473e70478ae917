// ---- a flock: boids, the modes of their shells, and one instanced draw, all in textures ----
const birds = data.birds, m = data.modes, n = data.vertices, ACROSS = 256;
const boidRows = Math.ceil(birds / ACROSS), modeRows = Math.ceil(birds * m / WIDTH);
const state = {time: 0, paused: false, weights: [...data.weights, data.targetWeight], flap: 1};
const FETCH = `
vec3 of(sampler2D from, int i) { return texelFetch(from, ivec2(i % ${ACROSS}, i / ${ACROSS}), 0).xyz; }
vec3 unit(vec3 v) { float s = length(v); return s > 0.0 ? v / s : vec3(0.0); }
`;
const BOIDS = FETCH + `
uniform sampler2D place, heading, own, knots;
uniform vec4 weights; uniform vec3 home, target, low, high; uniform bool bounded, drawn;
uniform float dt, time, reach, cosine, turning, speed, variation, frequency;
layout(location = 0) out vec4 placed; layout(location = 1) out vec4 headed; layout(location = 2) out vec4 pulled;
float speedAt(float offset, float t) {  // [perlin2002]
  float at = frequency * t + offset, knot = floor(at), part = at - knot;
  float fade = part * part * part * (part * (6.0 * part - 15.0) + 10.0);
  int first = int(mod(knot, 256.0));
  float a = texelFetch(knots, ivec2(first, 0), 0).x, b = texelFetch(knots, ivec2((first + 1) % 256, 0), 0).x;
  return speed * (1.0 + variation * (a + fade * (b - a)));
}
void main() {
  int i = int(gl_FragCoord.x) + ${ACROSS} * int(gl_FragCoord.y);
  if (i >= ${birds}) { placed = headed = pulled = vec4(0.0); return; }
  vec3 x = of(place, i), d = of(heading, i), away = vec3(0.0), along = vec3(0.0), middle = vec3(0.0);
  float count = 0.0;
  for (int j = 0; j < ${birds}; j++) {
    vec3 y = of(place, j), gap = y - x;
    float squared = dot(gap, gap);
    if (squared >= reach * reach || squared == 0.0) continue;
    float far = sqrt(squared);
    if (dot(d, gap) < cosine * far) continue;
    away += (1.0 / reach - 1.0 / far) * gap; along += of(heading, j); middle += y; count += 1.0;
  }
  vec3 goal = weights.x * away + weights.y * along / max(count, 1.0);
  goal += weights.z * unit((middle + home) / (count + 1.0) - x);
  if (drawn) goal += weights.w * unit(target - x);
  if (bounded) goal += (clamp(x, low, high) - x) / reach;
  vec3 turned = unit(goal + exp(-turning * dt) * (d - goal));
  if (turned == vec3(0.0)) turned = d;
  float offset = of(own, i).x;
  vec3 velocity = turned * speedAt(offset, time + dt);
  placed = vec4(x + dt * velocity, 0.0);
  headed = vec4(turned, 0.0);
  pulled = vec4((velocity - d * speedAt(offset, time)) / dt, 0.0);
}`;
const FRAME = `
mat3 frameOf(vec3 forward, vec3 pull, vec3 gravity) {  // x forward, z up, banked as in a coordinated turn
  vec3 lift = pull - gravity, up = lift - dot(lift, forward) * forward;
  if (length(up) <= 1e-5 * length(lift)) {
    vec3 size = abs(forward), axis = size.x <= size.y && size.x <= size.z ? vec3(1.0, 0.0, 0.0) : size.y <= size.z ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0);
    up = axis - dot(axis, forward) * forward;
  }
  up = normalize(up);
  return mat3(forward, cross(up, forward), up);
}
`;
const MODES = FETCH + FRAME + `
uniform sampler2D modal, heading, pull, own, modes; uniform vec3 gravity; uniform float time, beat, largest, flap;
out vec4 after;
void main() {
  int at = int(gl_FragCoord.x) + ${WIDTH} * int(gl_FragCoord.y), i = at / ${m}, k = at % ${m};
  if (i >= ${birds}) { after = vec4(0.0); return; }
  vec4 mode = texelFetch(modes, ivec2(k, 0), 0);  // weights and flap
  vec4 free = texelFetch(modes, ivec2(k, 1), 0), push = texelFetch(modes, ivec2(k, 2), 0);  // exact flow: e11 e12 e21 e22; a1 a2 b1 b2
  vec3 a = of(pull, i), felt = transpose(frameOf(of(heading, i), a, gravity)) * (gravity - a);
  float factor = min(length(felt) / length(gravity), largest);
  float force = dot(mode.xyz, felt) + flap * factor * sin(beat * time + of(own, i).y) * mode.w;
  vec4 old = texelFetch(modal, ivec2(gl_FragCoord.xy), 0);  // coordinate, rate, and the last force if w is 1
  float kept = old.w == 1.0 ? old.z : force, change = force - kept;
  float q = dot(free.xy, old.xy) + push.x * kept + push.y * change, v = dot(free.zw, old.xy) + push.z * kept + push.w * change;
  after = vec4(q, v, force, 1.0);
}`;
const DRAWN = FETCH + FRAME + WARP + `
uniform sampler2D table, place, heading, pull, modal, scales; uniform mat4 camera; uniform vec3 gravity;
in vec3 rest; out vec3 place_;
vec3 entry(int at) { return texelFetch(table, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0).xyz; }
void main() {
  vec3 u = vec3(0.0), w = vec3(0.0);
  for (int k = 0; k < ${m}; k++) {
    int at = gl_InstanceID * ${m} + k;
    float q = texelFetch(modal, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0).x;
    vec2 scale = texelFetch(scales, ivec2(k, 0), 0).xy;
    u += q * scale.x * entry(k * ${n} + gl_VertexID);
    w += q * scale.y * entry((${m} + k) * ${n} + gl_VertexID);
  }
  mat3 turn = frameOf(of(heading, gl_InstanceID), of(pull, gl_InstanceID), gravity);
  place_ = of(place, gl_InstanceID) + turn * (rest + warped(u, w));
  gl_Position = camera * vec4(place_, 1.0);
}`;
const rest = new Float32Array(bytes(data.rest)), faces = new Uint32Array(bytes(data.faces));
const scales = new Float32Array(4 * m), modeTable = new Float32Array(12 * m), knots = new Float32Array(4 * 256);
for (let k = 0; k < m; k++) {
  scales.set([data.phi.scales[k], data.psi.scales[k]], 4 * k);
  modeTable.set([...data.modalWeights[k], data.flapForce[k]], 4 * k);
  modeTable.set(data.flow[k].slice(0, 4), 4 * (m + k)); modeTable.set(data.flow[k].slice(4), 4 * (2 * m + k));
}
data.knots.forEach((value, i) => { knots[4 * i] = value; });
let boids = null, modes = null, drawn = null, mesh = null, empty = null, fixed = null, now = null, next = null;
function spread(vectors, width) {  // numbers (birds, width) in texels
  const out = new Float32Array(4 * ACROSS * boidRows);
  for (let i = 0; i < birds; i++) for (let a = 0; a < width; a++) out[4 * i + a] = vectors[width * i + a];
  return floats(ACROSS, boidRows, out);
}
function fresh(filled) {
  const boid = name => filled ? spread(new Float32Array(bytes(data[name])), 3) : floats(ACROSS, boidRows, null);
  const rest = new Float32Array(4 * ACROSS * boidRows);
  return {place: boid("positions"), heading: boid("directions"), pull: floats(ACROSS, boidRows, rest),
          modal: floats(WIDTH, modeRows, new Float32Array(4 * WIDTH * modeRows))};
}
function restart() {
  for (const set of [now, next]) if (set) Object.values(set).forEach(made => gl.deleteTexture(made));
  now = fresh(true); next = fresh(false);
  state.time = 0;
}
function targetAt(time) {  // between the samples of the target's path, over and over
  const path = data.target;
  if (!path) return [0, 0, 0];
  const at = Math.min((data.repeat ? time % data.repeat : time) / data.sample, path.length - 1), i = Math.min(Math.floor(at), path.length - 2);
  return path.length < 2 ? path[0] : path[i].map((value, a) => value + (at - i) * (path[i + 1][a] - value));
}
function step() {
  const dt = data.dt, use = boids.places;
  gl.bindVertexArray(empty);
  gl.useProgram(boids.made);
  bind(use, {place: now.place, heading: now.heading, own: fixed.own, knots: fixed.knots});
  gl.uniform4fv(use.weights, state.weights);
  gl.uniform3fv(use.home, data.home); gl.uniform3fv(use.target, targetAt(state.time));
  gl.uniform1i(use.drawn, data.target ? 1 : 0); gl.uniform1i(use.bounded, data.bounds ? 1 : 0);
  gl.uniform3fv(use.low, data.bounds ? data.bounds[0] : [0, 0, 0]); gl.uniform3fv(use.high, data.bounds ? data.bounds[1] : [0, 0, 0]);
  const numbers = {dt, time: state.time, reach: data.reach, cosine: data.cosine, turning: data.turning, speed: data.speed,
                   variation: data.variation, frequency: data.frequency};
  for (const [name, value] of Object.entries(numbers)) gl.uniform1f(use[name], value);
  into([next.place, next.heading, next.pull], ACROSS, boidRows);
  state.time += dt;
  const own = modes.places;
  gl.useProgram(modes.made);
  bind(own, {modal: now.modal, heading: next.heading, pull: next.pull, own: fixed.own, modes: fixed.modes});
  gl.uniform3fv(own.gravity, data.gravity);
  const beats = {time: state.time, beat: 2 * Math.PI * data.beats, largest: data.largest, flap: state.flap};
  for (const [name, value] of Object.entries(beats)) gl.uniform1f(own[name], value);
  into([next.modal], WIDTH, modeRows);
  [now, next] = [next, now];
}
function steps(count) { for (let i = 0; i < count; i++) step(); }
function draw() {
  const use = drawn.places;
  clear();
  gl.useProgram(drawn.made);
  gl.bindVertexArray(mesh);
  bind(use, {table: fixed.table, place: now.place, heading: now.heading, pull: now.pull, modal: now.modal, scales: fixed.scales});
  gl.uniformMatrix4fv(use.camera, false, cameraMatrix());
  gl.uniform3fv(use.gravity, data.gravity);
  gl.uniform3fv(use.towards, axes()[2]);
  gl.drawElementsInstanced(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0, birds);
}
function labels() {
  ["separation", "alignment", "cohesion", "target"].forEach((name, i) => show(name + "_value", state.weights[i].toFixed(2)));
  show("flap_value", state.flap.toFixed(2)); show("pause", state.paused ? "Play" : "Pause"); show("birds", birds);
}
function restore() {  // what the address says; the flock itself begins anew
  const {words, numbers} = linked();
  if (numbers("weights", 4)) state.weights = numbers("weights", 4);
  if (numbers("flap", 1)) state.flap = numbers("flap", 1)[0];
  state.paused = words.paused === "1";
  ["separation", "alignment", "cohesion", "target"].forEach((name, i) => { element(name).value = state.weights[i]; });
  element("flap").value = state.flap;
}
function connect() {
  ["separation", "alignment", "cohesion", "target"].forEach((name, i) => {
    element(name).value = state.weights[i];
    element(name).oninput = event => { state.weights[i] = +event.target.value; labels(); };
  });
  element("flap").value = state.flap;
  element("flap").oninput = event => { state.flap = +event.target.value; labels(); };
  element("pause").onclick = () => { state.paused = !state.paused; labels(); };
  element("restart").onclick = restart;
  camera.distance = data.distance; camera.centre = data.centre;
  camera.azimuth = data.azimuth; camera.elevation = data.elevation;
  if (view.clientWidth < 1.3 * view.clientHeight) camera.distance *= 1.3 * view.clientHeight / view.clientWidth;
  pointer({});
  connectPage({keys: {r: restart}, parts: () => ({weights: digits(state.weights), flap: digits([state.flap]), paused: +state.paused})});
  restore();
  labels();
}
let last = 0, owed = 0, frame = 0;
function tick(time) {
  owed = Math.min(owed + (last ? data.second * (time - last) / 1000 : 0), 3 * data.dt);
  last = time;
  while (!state.paused && owed >= data.dt) { step(); owed -= data.dt; }
  draw();
  if (frame++ % 6 === 0) show("time", state.time.toFixed(2) + " " + data.unit);
  requestAnimationFrame(tick);
}
const listed = (made, width, count) => {  // the first numbers of each boid's texel
  const all = values(made, ACROSS, boidRows), out = [];
  for (let i = 0; i < count; i++) for (let a = 0; a < width; a++) out.push(all[4 * i + a]);
  return out;
};
window.flock = {  // for scripts and tests
  state, camera, steps, restart,
  positions: () => listed(now.place, 3, birds), directions: () => listed(now.heading, 3, birds),
  coordinates: () => [...values(now.modal, WIDTH, modeRows)].filter((_, i) => i % 4 === 0).slice(0, birds * m),
};
if (gl && gl.getExtension("EXT_color_buffer_float")) {
  boids = program(EVERYWHERE, BOIDS);
  modes = program(EVERYWHERE, MODES);
  drawn = program(DRAWN.replaceAll("place_", "spot"), SHADED.replaceAll("place", "spot"));
  mesh = surface(drawn.made, rest, faces);
  empty = gl.createVertexArray();
  const halves = [data.phi, data.psi].map(part => new Uint16Array(bytes(part.halves)));
  fixed = {table: modalTexture(halves, n), scales: floats(m, 1, scales), modes: floats(m, 3, modeTable),
           knots: floats(256, 1, knots), own: spread(new Float32Array(bytes(data.own)), 2)};
  restart();
  connect();
  start(tick);
}
