// ---- a stored motion or answer: the rest shape and amounts of a few shapes in each frame, with the tones of a field ----
const record = data.record || null;
const scene = record && {
  times: record.times, shapes: floatsOf(record.shapes), count: record.shapes.scales.length,
  amounts: new Float32Array(bytes(record.amounts)), q: new Float64Array(record.shapes.scales.length),
  tones: record.tones && {
    values: floatsOf(record.tones.values), count: record.tones.values.scales.length,
    amounts: new Float32Array(bytes(record.tones.amounts)), now: new Float64Array(record.tones.values.scales.length),
  },
};
const still = scene !== null && scene.times.length === 1;
function playAt(time) {  // amounts between the two nearest frames
  const times = scene.times, last = times.length - 1;
  let f = 0;
  while (f < last && times[f + 1] < time) f++;
  const share = f < last ? (time - times[f]) / (times[f + 1] - times[f]) : 0;
  bodyFrame.first = f; bodyFrame.share = f < last ? share : 0;
  const between = (from, count, into) => {
    for (let k = 0; k < count; k++) {
      const here = from[f * count + k];
      into[k] = f < last ? here + share * (from[(f + 1) * count + k] - here) : here;
    }
  };
  between(scene.amounts, scene.count, scene.q);
  if (scene.tones) between(scene.tones.amounts, scene.tones.count, scene.tones.now);
}
function barNow() {  // the last error bar that was found up to now
  const bars = state.model === "scene" && record.bars;
  let k = -1;
  while (bars && k + 1 < bars.times.length && bars.times[k + 1] <= state.time + 1e-9) k++;
  return k < 0 ? "" : `, ${bars.texts[k]}`;
}
function scenePositions() {
  const out = new Float64Array(3 * n), u = new Float64Array(3);
  for (let i = 0; i < n; i++) {
    rowsTimes(scene.shapes, i, scene.q, u);
    for (let a = 0; a < 3; a++) out[3 * i + a] = rest[3 * i + a] + u[a];
  }
  return out;
}
function scenePoints() {  // places of every vertex in some of the frames, to frame them all
  const kept = Float64Array.from(scene.q), out = [rest], count = Math.min(24, scene.times.length);
  for (let i = 0; i < count; i++) {
    playAt(scene.times[count > 1 ? Math.round(i * (scene.times.length - 1) / (count - 1)) : 0]);
    out.push(scenePositions());
  }
  scene.q.set(kept);
  const all = new Float64Array(out.length * 3 * n);
  out.forEach((x, i) => all.set(x, 3 * n * i));
  return all;
}
function scenePrograms() {
  bodyPrograms();
  const K = scene.count, C = scene.tones ? scene.tones.count : 0;
  const vertex = `
uniform sampler2D table, tones; uniform float q[${Math.max(K, 1)}], level[${Math.max(C, 1)}]; uniform mat4 camera;
uniform vec2 range;
in vec3 rest; out vec3 place; out float toned;
vec4 entry(sampler2D from, int at) { return texelFetch(from, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0); }
void main() {
  place = rest; toned = 0.0;
  for (int k = 0; k < ${K}; k++) place += q[k] * entry(table, k * ${n} + gl_VertexID).xyz;
  for (int k = 0; k < ${C}; k++) toned += level[k] * entry(tones, k * ${n} + gl_VertexID).x;
  toned = (toned - range.x) / max(range.y - range.x, 1e-30);
  gl_Position = camera * vec4(place, 1.0);
}`;
  const tone = "uniform sampler2D ramp; in float toned; vec3 tone() { return texture(ramp, vec2(clamp(toned, 0.002, 0.998), 0.5)).rgb; }";
  scene.program = program(vertex, C ? shaded(tone, 0.3) : SHADED);
  scene.mesh = surface(scene.program.made, rest, faces);
  scene.table = modalTexture([halves(record.shapes)], n);
  scene.textures = {table: scene.table};
  if (!C) return;
  const columns = halves(record.tones.values), spread = new Uint16Array(3 * columns.length);
  for (let i = 0; i < columns.length; i++) { const row = Math.floor(i / C); spread[(3 * row) * C + i % C] = columns[i]; }
  const colours = new Uint8Array(bytes(record.tones.ramp)), ramp = texture(gl.RGB8, colours.length / 3, 1, gl.RGB, gl.UNSIGNED_BYTE, colours);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  Object.assign(scene.textures, {tones: modalTexture([spread], n), ramp});
}
function drawScene() {
  const use = scene.program.places;
  clear();
  gl.useProgram(scene.program.made);
  gl.bindVertexArray(scene.mesh);
  bind(use, scene.textures);
  if (scene.count) gl.uniform1fv(use.q, Float32Array.from(scene.q, (value, k) => value * record.shapes.scales[k]));
  if (scene.tones) {
    gl.uniform1fv(use.level, Float32Array.from(scene.tones.now, (value, k) => value * record.tones.values.scales[k]));
    gl.uniform2fv(use.range, record.tones.range);
  }
  gl.uniformMatrix4fv(use.camera, false, cameraMatrix());
  gl.uniform3fv(use.towards, axes()[2]);
  gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
  drawBodies();
}
function showScale() {  // the colour bar, where the field colours the shell
  const tones = record && record.tones;
  if (!tones) return;
  const colours = new Uint8Array(bytes(tones.ramp)), stops = [];
  for (let i = 0; i < colours.length; i += 3) stops.push(`rgb(${colours[i]}, ${colours[i + 1]}, ${colours[i + 2]})`);
  element("ramp").style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  show("ramp_low", tones.range[0].toPrecision(3)); show("ramp_high", tones.range[1].toPrecision(3)); show("ramp_label", tones.label);
}
