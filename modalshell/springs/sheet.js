// ---- a sheet of masses and springs: Verlet steps in textures that change places ----
const columns = data.columns, rows = data.rows;
const state = {time: 0, paused: false, gravity: data.gravity.slice(), drag: data.drag, grab: [-1, -1], target: [0, 0, 0], count: 0, free: false};
const STEP = `
uniform sampler2D now, before; uniform vec3 weight, target; uniform float keep, tiny, factor; uniform ivec2 grab;
uniform vec3 stiffness;
out vec4 after;
vec3 pull(ivec2 at, vec3 here, ivec2 side, float k, float rest) {
  ivec2 other = at + side;
  if (other.x < 0 || other.y < 0 || other.x >= ${columns} || other.y >= ${rows}) return vec3(0.0);
  vec3 d = texelFetch(now, other, 0).xyz - here;
  return (k - k * rest / sqrt(dot(d, d) + tiny)) * d;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 texel = texelFetch(now, at, 0);
  vec3 here = texel.xyz, force = vec3(0.0);
  float a = ${data.spacing}, b = a * sqrt(2.0), c = 2.0 * a;
  vec3 k = factor * stiffness;
  force += (pull(at, here, ivec2(1, 0), k.x, a) + pull(at, here, ivec2(-1, 0), k.x, a))
         + (pull(at, here, ivec2(0, 1), k.x, a) + pull(at, here, ivec2(0, -1), k.x, a));
  force += (pull(at, here, ivec2(1, 1), k.y, b) + pull(at, here, ivec2(-1, -1), k.y, b))
         + (pull(at, here, ivec2(-1, 1), k.y, b) + pull(at, here, ivec2(1, -1), k.y, b));
  force += (pull(at, here, ivec2(2, 0), k.z, c) + pull(at, here, ivec2(-2, 0), k.z, c))
         + (pull(at, here, ivec2(0, 2), k.z, c) + pull(at, here, ivec2(0, -2), k.z, c));
  vec3 moved = here + keep * (here - texelFetch(before, at, 0).xyz) + (force + weight);
  after = vec4(texel.w > 0.5 ? here : at == grab ? target : moved, texel.w);
}`;
const DRAWN = `
uniform sampler2D now; uniform mat4 camera; out vec3 place;
void main() {  // two triangles a cell, without buffers
  int cell = gl_VertexID / 6, corner = gl_VertexID % 6;
  ivec2 at = ivec2(cell % ${columns - 1}, cell / ${columns - 1});
  at += corner == 0 ? ivec2(0, 0) : corner == 1 || corner == 3 ? ivec2(1, 0) : corner == 2 || corner == 5 ? ivec2(0, 1) : ivec2(1, 1);
  place = texelFetch(now, at, 0).xyz;
  gl_Position = camera * vec4(place, 1.0);
}`;
let stepped = null, drawn = null, now = null, before = null, spare = null, empty = null;
function numbersOf(dt) {  // what a force over the mass moves in a step, and the part of the velocity that drag leaves
  const half = 0.5 * dt * state.drag;
  return [dt * dt / (1 + half), (1 - half) / (1 + half)];
}
function restart() {
  const here = new Float32Array(4 * rows * columns), past = new Float32Array(4 * rows * columns);
  const held = new Set(data.pinned);
  state.free = !held.size;
  for (let i = 0; i < rows * columns; i++) {
    const free = held.has(i) ? 0 : 1;
    const x = [data.spacing * (i % columns) - data.middle[0], data.spacing * Math.floor(i / columns) - data.middle[1], 0];
    for (let a = 0; a < 3; a++) {
      here[4 * i + a] = x[a];
      past[4 * i + a] = x[a] + free * 0.5 * data.dt ** 2 * state.gravity[a];  // at rest now
    }
    here[4 * i + 3] = past[4 * i + 3] = 1 - free;
  }
  for (const old of [now, before, spare]) if (old) gl.deleteTexture(old);
  now = floats(columns, rows, here); before = floats(columns, rows, past); spare = floats(columns, rows, null);
  state.time = state.count = 0;
}
function letGo() {
  const here = values(now, columns, rows);
  for (let i = 3; i < here.length; i += 4) here[i] = 0;
  gl.deleteTexture(now);
  now = floats(columns, rows, here);
  state.free = true;
}
function steps(count) {
  const [factor, keep] = numbersOf(data.dt), use = stepped.places;
  gl.useProgram(stepped.made);
  gl.bindVertexArray(empty);
  gl.uniform3fv(use.weight, state.gravity.map(g => factor * g));
  gl.uniform3fv(use.stiffness, data.stiffness);
  gl.uniform1f(use.factor, factor); gl.uniform1f(use.keep, keep); gl.uniform1f(use.tiny, data.tiny);
  gl.uniform2iv(use.grab, state.grab); gl.uniform3fv(use.target, state.target);
  for (let i = 0; i < count; i++) {
    bind(use, {now, before});
    into([spare], columns, rows);
    [now, before, spare] = [spare, now, before];
  }
  state.count += count;
  state.time += count * data.dt;
}
function positions() { return values(now, columns, rows); }
function labels() {
  show("gravity_value", state.gravity[2].toFixed(1)); show("drag_value", state.drag.toFixed(2));
  show("pause", state.paused ? "Play" : "Pause"); show("masses", `${rows} x ${columns}`);
}
function connect() {
  element("gravity").value = state.gravity[2]; element("drag").value = state.drag;
  element("pause").onclick = () => { state.paused = !state.paused; labels(); };
  element("restart").onclick = restart;
  element("free").onclick = letGo;
  element("gravity").oninput = event => { state.gravity = [0, 0, +event.target.value]; labels(); };
  element("drag").oninput = event => { state.drag = +event.target.value; labels(); };
  let unit = 1, from = [0, 0], hold = [0, 0, 0];
  pointer({
    press: (x, y) => {
      const here = positions(), nearest = nearestPoint(here, 4, x, y);
      if (nearest < 0 || here[4 * nearest + 3] > 0.5) return false;
      hold = [...here.subarray(4 * nearest, 4 * nearest + 3)];
      unit = projected(hold)[2]; from = [x, y];
      state.grab = [nearest % columns, Math.floor(nearest / columns)]; state.target = hold;
      return true;
    },
    drag: (x, y) => {
      const [right, up] = axes(), dx = (x - from[0]) / unit, dy = (from[1] - y) / unit;
      state.target = hold.map((value, a) => value + dx * right[a] + dy * up[a]);
    },
    drop: () => { state.grab = [-1, -1]; },
  });
  framing.on = true;
  framing.points = () => {  // the sheet, and where it hangs to
    const [x, y] = data.middle, low = state.gravity[2] < 0 ? -data.size : 0;
    return [0, low].flatMap(z => [-x, -y, z, 1, x, -y, z, 1, -x, y, z, 1, x, y, z, 1]);
  };
  framing.stride = 4;
  connectPage({keys: {r: restart}, parts: () => ({gravity: digits(state.gravity), drag: digits([state.drag]), paused: +state.paused})});
  const {words, numbers} = linked();
  if (numbers("gravity", 3)) state.gravity = numbers("gravity", 3);
  if (numbers("drag", 1)) state.drag = Math.max(0, numbers("drag", 1)[0]);
  element("gravity").value = state.gravity[2]; element("drag").value = state.drag;
  state.paused = words.paused === "1";
  labels();
}
function draw() {
  clear();
  gl.useProgram(drawn.made);
  gl.bindVertexArray(empty);
  bind(drawn.places, {now});
  gl.uniformMatrix4fv(drawn.places.camera, false, cameraMatrix());
  gl.uniform3fv(drawn.places.towards, axes()[2]);
  gl.drawArrays(gl.TRIANGLES, 0, 6 * (rows - 1) * (columns - 1));
}
let last = 0, owed = 0, frame = 0;
function tick(time) {
  owed = Math.min(owed + (last ? (time - last) / 1000 : 0), data.most * data.dt);
  last = time;
  const due = state.paused ? 0 : Math.floor(owed / data.dt);
  if (due) { steps(due); owed -= due * data.dt; }
  // It swings beyond; what is let go falls out of the picture. Many masses are slow to read.
  if (due && !state.free && (rows * columns <= 16384 || frame % 8 === 0)) keepFramed(positions());
  draw();
  if (frame++ % 6 === 0) { show("time", state.time.toFixed(2) + " s"); show("rate", due); }
  requestAnimationFrame(tick);
}
window.sheet = {state, camera, steps, restart, positions};  // for scripts and tests
if (gl && gl.getExtension("EXT_color_buffer_float")) {
  stepped = program(EVERYWHERE, STEP);
  drawn = program(DRAWN, SHADED);
  empty = gl.createVertexArray();
  restart();
  connect();
  start(tick);
}
