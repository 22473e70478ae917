// ---- what all pages share: numbers, and programs of the GPU ----
function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out.buffer;
}
const element = name => document.getElementById(name);
const show = (name, text) => { element(name).textContent = text; };
const view = element("view"), canvas = document.createElement("canvas");
const gl = canvas.getContext("webgl2", {antialias: true, preserveDrawingBuffer: true});
const FOCUS = 1.8, WIDTH = 2048;

function program(vertex, fragment) {  // a linked program and the places of its uniforms, by name
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, "#version 300 es\nprecision highp float; precision highp int; precision highp sampler2D;\n" + text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const name = gl.getActiveUniform(made, i).name;
    places[name.replace("[0]", "")] = gl.getUniformLocation(made, name);
  }
  return {made, places};
}
function texture(internal, width, height, format, kind, values) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
  gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, kind, values);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return made;
}
const floats = (width, height, values) => texture(gl.RGBA32F, width, height, gl.RGBA, gl.FLOAT, values);
function bind(uniforms, textures) {  // textures by the names of their samplers
  Object.entries(textures).forEach(([name, made], unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.uniform1i(uniforms[name], unit);
  });
}
const EVERYWHERE = `void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
function into(targets, width, height) {  // run the program in use for every texel of the targets
  gl.bindFramebuffer(gl.FRAMEBUFFER, into.buffer = into.buffer || gl.createFramebuffer());
  targets.forEach((made, i) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, made, 0));
  for (let i = targets.length; i < 4; i++) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, null, 0);
  gl.drawBuffers(targets.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
  gl.viewport(0, 0, width, height);
  gl.disable(gl.DEPTH_TEST);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
}
function values(made, width, height) {  // RGBA numbers of a texture
  const out = new Float32Array(4 * width * height), buffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made, 0);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, out);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(buffer);
  return out;
}
const WARP = `  // [choi2007, eq. 16]
vec3 warped(vec3 u, vec3 w) {
  float s = dot(w, w), t = sqrt(s);
  float b = s < 1e-2 ? 0.5 - s / 24.0 + s * s / 720.0 : (1.0 - cos(t)) / s;
  float c = s < 1e-2 ? 1.0 / 6.0 - s / 120.0 + s * s / 5040.0 : (t - sin(t)) / (s * t);
  vec3 x = cross(w, u);
  return u + b * x + c * cross(w, x);
}
`;
const shaded = (tone, shade = 0.65) => `
uniform vec3 towards; in vec3 place; out vec4 colour;
${tone}
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  float light = ${1 - shade} + ${shade} * abs(dot(normal, towards));
  colour = vec4(light * tone(), 1.0);
}`;
const SHADED = shaded("vec3 tone() { return gl_FrontFacing ? vec3(0.36, 0.55, 0.78) : vec3(0.85, 0.62, 0.36); }");
function clear() {  // the canvas at its size in the page, in the colour of its background
  const scale = window.devicePixelRatio || 1, width = Math.round(scale * view.clientWidth);
  const height = Math.round(scale * view.clientHeight);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  gl.viewport(0, 0, width, height);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(...backdrop(), 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
}
function modalTexture(tables, n) {  // half floats (n, 3, columns) of each table, entry column * n + vertex
  const columns = tables.reduce((sum, half) => sum + half.length / (3 * n), 0);
  const texels = new Uint16Array(3 * WIDTH * Math.ceil(columns * n / WIDTH));
  let first = 0;
  for (const half of tables) {
    const m = half.length / (3 * n);
    for (let i = 0; i < n; i++) for (let a = 0; a < 3; a++) for (let k = 0; k < m; k++)
      texels[3 * ((first + k) * n + i) + a] = half[(3 * i + a) * m + k];
    first += m;
  }
  return texture(gl.RGB16F, WIDTH, texels.length / (3 * WIDTH), gl.RGB, gl.HALF_FLOAT, texels);
}
function surface(made, rest, faces) {  // attribute and index buffers of a mesh
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, rest, gl.STATIC_DRAW);
  const at = gl.getAttribLocation(made, "rest"), array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return array;
}
