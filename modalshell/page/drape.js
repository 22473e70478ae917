// ---- the drape meter: bending stiffness of an overhang and a weight, its cards, its drape ----
const lengths = data.lengths, K = lengths.length, faces = new Uint16Array(bytes(data.faces));
const stored = new Int16Array(bytes(data.positions)), n = stored.length / (3 * K);
const state = {overhang: data.overhang * 27.2e-3, weight: 0.324}  // of a denim;
const shape = new Float32Array(3 * n);
let drawn = null, stand = null, buffer = null, clothArray = null, discArray = null, discFaces = null;

const bendingLength = () => state.overhang / data.overhang;
const bending = () => state.weight * data.gravity * bendingLength() ** 3;
function between(length) {  // the two members of the family about a bending length, and the share of the second
  const x = Math.log(Math.max(Math.min(length, lengths[0]), lengths[K - 1]));
  let k = 0;
  while (k < K - 2 && x < Math.log(lengths[k + 1])) k++;
  const a = Math.log(lengths[k]), b = Math.log(lengths[k + 1]);
  return [k, Math.min(Math.max((x - a) / (b - a), 0), 1)];
}
function drape(length) {  // places of the cloth, and its drape coefficient
  const [k, share] = between(length), first = 3 * n * k, second = first + 3 * n;
  for (let i = 0; i < 3 * n; i++) shape[i] = data.scale * ((1 - share) * stored[first + i] + share * stored[second + i]);
  return (1 - share) * data.coefficients[k] + share * data.coefficients[k + 1];
}
function spread(runs, length) {  // largest distance from the interpolation among the three nearest of such runs
  const near = runs.map(([at, missed]) => [Math.abs(Math.log(at / length)), Math.abs(missed)]).sort((a, b) => a[0] - b[0]);
  return Math.max(...near.slice(0, 3).map(one => one[1]));
}
function nearest(length, weight) {
  const far = card => {
    const own = (card.bending / (card.weight * data.gravity)) ** (1 / 3);
    return Math.hypot(Math.log(own / length), Math.log(card.weight / weight) / 3);
  };
  return [...data.cards].sort((a, b) => far(a) - far(b)).slice(0, 3);
}
const number = value => +value.toPrecision(4);
function material() {  // stretch is not measured by an overhang: that of the nearest card that has one
  const B = bending(), card = nearest(bendingLength(), state.weight).concat(data.cards).find(one => one.stretch);
  const three = [B, B, B / 2].map(number).join(", ");
  return `[material]\nkind = "fabric"\nbending = [${three}]  # N m\nstretch = [${card.stretch.map(number).join(", ")}]  # N/m, of ${card.name}\n` +
    `density = ${number(state.weight)}  # kg/m^2`;
}
function update() {
  const length = bendingLength(), coefficient = drape(length), B = bending();
  show("overhang_value", (1e3 * state.overhang).toFixed(1)); show("weight_value", (1e3 * state.weight).toFixed(1));
  element("overhang").value = 1e3 * state.overhang; element("weight").value = 1e3 * state.weight;
  show("bending", `${(1e6 * B).toPrecision(4)} µN m`); show("length", `${(1e3 * length).toFixed(2)} mm`);
  show("coefficient", `${(100 * coefficient).toFixed(1)} %`);
  const out = length > lengths[0] || length < lengths[K - 1];
  show("error", out ? "Beyond the computed drapes: the nearest is drawn."
       : `Runs from nearby shapes are within ${(100 * spread(data.missed, length)).toFixed(1)} points of this coefficient; `
         + `cloths laid flat may fold otherwise: within ${(100 * spread(data.scatter, length)).toFixed(1)} points. `
         + `Run this cloth from the shape drawn: python -m studies.drape_family --length ${length.toPrecision(4)}`);
  const list = nearest(length, state.weight).map(card => {
    const button = document.createElement("button");
    button.textContent = `${card.name} (${card.what})`;
    button.onclick = () => choose(card);
    return button;
  });
  element("cards").replaceChildren(...list);
  show("material", material());
  if (gl && buffer) { gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.bufferData(gl.ARRAY_BUFFER, shape, gl.DYNAMIC_DRAW); }
}
function choose(card) {  // the overhang and weight that it would be measured with
  state.weight = card.weight;
  state.overhang = data.overhang * (card.bending / (card.weight * data.gravity)) ** (1 / 3);
  update();
}
function arrays(made, values, indices) {
  const array = gl.createVertexArray(), own = gl.createBuffer(), at = gl.getAttribLocation(made, "rest");
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, own);
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return [array, own];
}
function prepare() {
  const vertex = "uniform mat4 camera; in vec3 rest; out vec3 place; void main() { place = rest; gl_Position = camera * vec4(rest, 1.0); }";
  drawn = program(vertex, SHADED);
  stand = program(vertex, shaded("vec3 tone() { return vec3(0.62); }", 0.4));
  [clothArray, buffer] = arrays(drawn.made, shape, faces);
  const sides = 64, places = [0, 0, 0.0015], list = [];  // the upper disc, and the side of the stand
  for (const [radius, height] of [[data.discs, 0.0015], [0.97 * data.discs, -0.0015], [0.97 * data.discs, -0.08]])
    for (let i = 0; i < sides; i++) places.push(radius * Math.cos(2 * Math.PI * i / sides), radius * Math.sin(2 * Math.PI * i / sides), height);
  for (let i = 0; i < sides; i++) {
    const j = (i + 1) % sides, a = 1 + sides, b = 1 + 2 * sides;
    list.push(0, 1 + i, 1 + j, a + i, b + i, a + j, a + j, b + i, b + j);
  }
  discFaces = new Uint16Array(list);
  [discArray] = arrays(stand.made, new Float32Array(places), discFaces);
}
function draw() {
  clear();
  for (const [made, array, count] of [[stand, discArray, discFaces.length], [drawn, clothArray, faces.length]]) {
    gl.useProgram(made.made);
    gl.bindVertexArray(array);
    gl.uniformMatrix4fv(made.places.camera, false, cameraMatrix());
    gl.uniform3fv(made.places.towards, axes()[2]);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_SHORT, 0);
  }
  gl.bindVertexArray(null);
}
function tick() {
  draw();
  requestAnimationFrame(tick);
}
function connect() {
  framing.on = true;
  framing.points = () => Float32Array.from({length: 3 * 16}, (_, i) => {  // the flat cloth and the lowest hem
    const angle = Math.PI * Math.floor(i / 6) / 4, low = Math.floor(i / 3) % 2, radius = low ? data.discs : data.cloth;
    return [radius * Math.cos(angle), radius * Math.sin(angle), low ? -0.07 : 0.002][i % 3];
  });
  for (const [name, scale] of [["overhang", 1e-3], ["weight", 1e-3]])
    element(name).oninput = event => { state[name] = scale * event.target.value; update(); };
  element("copy").onclick = () => {
    const done = () => show("said", "Material copied.");
    if (navigator.clipboard) navigator.clipboard.writeText(material()).then(done, () => show("said", "Select the text and copy it."));
    else show("said", "Select the text and copy it.");
  };
  element("pause").hidden = true;
  pointer({});
  connectPage({parts: () => ({overhang: digits([state.overhang]), weight: digits([state.weight])}), keys: {" ": () => {}}});
  if (element("rest").hidden) element("fold").click();  // its sliders are what the page is for, on a phone too
  const {numbers} = linked();
  for (const name of ["overhang", "weight"]) if (numbers(name, 1) && numbers(name, 1)[0] > 0) state[name] = numbers(name, 1)[0];
}
window.shell = {state, camera, update, drape, bending, bendingLength, choose, material, nearest, spread, cards: data.cards, shape};
if (gl) {
  prepare();
  connect();
  update();
  start(tick);
}
