// ---- a shell that moves live: LMA, MWTS and reduced RSW ----
function fromHalf(halves, scales, m) {  // (n, 3, m) half floats times a scale for each mode
  const out = new Float32Array(halves.length);
  for (let i = 0; i < halves.length; i++) {
    const h = halves[i], exponent = (h >> 10) & 31, fraction = h & 1023;
    const size = exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24;
    out[i] = (h & 0x8000 ? -size : size) * scales[i % m];
  }
  return out;
}
const halves = part => new Uint16Array(bytes(part.halves)), floatsOf = part => fromHalf(halves(part), part.scales, part.scales.length);
const live = data.live || null, n = data.vertices, m = live ? live.phi.scales.length : 0;
const rest = new Float32Array(bytes(data.rest));
const faces = Uint32Array.from(n > 65536 ? new Uint32Array(bytes(data.faces)) : new Uint16Array(bytes(data.faces)));
const phi = live && floatsOf(live.phi), psi = live && floatsOf(live.psi);
const reduced = live && live.reduced || null, r = reduced ? reduced.shapes.scales.length : 0;
const shapes = reduced && floatsOf(reduced.shapes), amounts = reduced && floatsOf(reduced.amounts), turns = reduced && floatsOf(reduced.turns);
const mass = live && new Float32Array(bytes(live.mass));
const force = live && live.force ? new Float32Array(bytes(live.force)) : null;
const lambda = live ? live.eigenvalues : [];
const free = live && live.frames || null, rigid = free ? free.count : 0;  // parts that no support holds: free_parts.js
const state = {  // model: "scene" is the stored motion or answer
  q: new Float64Array(m), v: new Float64Array(m), time: 0, count: m, model: data.record ? "scene" : "mwts",
  xi: live ? live.damping[0] : 0, zeta: live ? live.damping[1] : 0,
  gravity: data.gravity.slice(), pull: null, shown: -1, paused: false,
};

// ---- the model: warp, modal force, exact flow of modes under a kept force ----
function rowsTimes(matrix, i, q, out) {
  const m = q.length;
  let x = 0, y = 0, z = 0, at = 3 * i * m;
  for (let k = 0; k < m; k++) x += matrix[at++] * q[k];
  for (let k = 0; k < m; k++) y += matrix[at++] * q[k];
  for (let k = 0; k < m; k++) z += matrix[at++] * q[k];
  out[0] = x; out[1] = y; out[2] = z;
}
function combination(w, u, a, b, c, out) {  // a u + b w x u + c w x (w x u)
  const x = w[1] * u[2] - w[2] * u[1], y = w[2] * u[0] - w[0] * u[2], z = w[0] * u[1] - w[1] * u[0];
  out[0] = a * u[0] + b * x + c * (w[1] * z - w[2] * y);
  out[1] = a * u[1] + b * y + c * (w[2] * x - w[0] * z);
  out[2] = a * u[2] + b * z + c * (w[0] * y - w[1] * x);
}
const W = new Float64Array(3), U = new Float64Array(3), F = new Float64Array(3), T = new Float64Array(3);
const bent = new Float64Array(r);  // coordinates of the shapes that reduced RSW adds
// Numbers of sampled triangle t, in its frame: turn w, strain (aa, bb, ab), and the columns Ra, Rb of exp([w]).
function turned(t, q) {
  const p = new Float64Array(6);
  for (let c = 0; c < 6; c++) for (let k = 0, at = (c * turns.length / (6 * m) + t) * m; k < m; k++) p[c] += turns[at + k] * q[k];
  const [x, y, z] = p, s = x * x + y * y + z * z, f = Math.sqrt(s), small = s < 1e-4;
  const c1 = small ? 1 - s / 6 : Math.sin(f) / f, c2 = small ? 0.5 - s / 24 : (1 - Math.cos(f)) / s;
  const d1 = small ? s / 60 - 1 / 6 : (Math.cos(f) - c1) / (2 * s), d2 = small ? s / 360 - 1 / 24 : (c1 - 2 * c2) / (2 * s);
  const a = [1 + c2 * (x * x - s), c1 * z + c2 * x * y, c2 * x * z - c1 * y];
  const b = [c2 * x * y - c1 * z, 1 + c2 * (y * y - s), c1 * x + c2 * y * z];
  return {w: [x, y, z], strain: [p[3], p[4], p[5]], a, b, s, c1, c2, d1, d2};
}
function bend(q) {  // amounts of F(q) - I less its linear part
  if (state.model !== "rsw") return;
  bent.fill(0);
  const count = turns.length / (6 * m);
  for (let t = 0; t < count; t++) {
    const {w, strain: [aa, bb, ab], a, b} = turned(t, q);
    for (let i = 0; i < 3; i++) {
      const along = a[i] * (1 + aa) + b[i] * ab - [1 + aa, ab + w[2], -w[1]][i];
      const across = a[i] * ab + b[i] * (1 + bb) - [ab - w[2], 1 + bb, w[0]][i];
      for (let k = 0; k < r; k++) bent[k] += amounts[(i * count + t) * r + k] * along + amounts[((3 + i) * count + t) * r + k] * across;
    }
  }
}
function addBentForce(q, push, p) {  // gradient of push . bent(q) [huang2011]
  const count = turns.length / (6 * m), dot = (x, y) => x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
  for (let t = 0; t < count; t++) {
    const {w, strain: [aa, bb, ab], a, b, s, c1, c2, d1, d2} = turned(t, q), ga = [0, 0, 0], gb = [0, 0, 0];
    for (let i = 0; i < 3; i++) for (let k = 0; k < r; k++) {
      ga[i] += amounts[(i * count + t) * r + k] * push[k]; gb[i] += amounts[((3 + i) * count + t) * r + k] * push[k];
    }
    const na = ga.map((x, i) => x * (1 + aa) + gb[i] * ab), nb = gb.map((x, i) => ga[i] * ab + x * (1 + bb));
    const axial = [nb[2], -na[2], na[1] - nb[0]], trace = na[0] + nb[1], alongA = dot(w, na), alongB = dot(w, nb);
    const slope = 2 * (d1 * dot(axial, w) + d2 * (alongA * w[0] + alongB * w[1] - s * trace));
    const by = [0, 1, 2].map(i => c1 * axial[i] + c2 * (na[i] * w[0] + nb[i] * w[1] + [alongA, alongB, 0][i] - 2 * w[i] * trace) + slope * w[i]);
    by.push(dot(ga, a), dot(gb, b), dot(ga, b) + dot(gb, a));
    const linear = [gb[2], -ga[2], ga[1] - gb[0], ga[0], gb[1], ga[1] + gb[0]];
    for (let c = 0; c < 6; c++) for (let k = 0, at = (c * count + t) * m; k < m; k++) p[k] += turns[at + k] * (by[c] - linear[c]);
  }
}
function position(i, q, out) {  // after bend(q)
  rowsTimes(phi, i, q, U);
  if (state.model === "rsw") {
    rowsTimes(shapes, i, bent, T);
    for (let a = 0; a < 3; a++) U[a] += T[a];
  } else if (state.model === "mwts") {
    rowsTimes(psi, i, q, W);
    const s = W[0] * W[0] + W[1] * W[1] + W[2] * W[2], t = Math.sqrt(s), small = s < 1e-4;
    combination(W, U, 1, small ? 0.5 - s / 24 : (1 - Math.cos(t)) / s,
                small ? 1 / 6 - s / 120 : (t - Math.sin(t)) / (s * t), T);
    U.set(T);
  }
  out[0] = rest[3 * i] + U[0]; out[1] = rest[3 * i + 1] + U[1]; out[2] = rest[3 * i + 2] + U[2];
}
function loadOn(i) {  // into F
  const g = state.gravity;
  for (let a = 0; a < 3; a++) F[a] = mass[i] * g[a] + (force ? force[3 * i + a] : 0);
  if (state.pull && state.pull.vertex === i) for (let a = 0; a < 3; a++) F[a] += state.pull.force[a];
}
function modalForce(q, p) { if (free) freeForce(q, state.v, p); else warpedForce(q, p, loadOn); }
function warpedForce(q, p, loaded) {
  p.fill(0);
  const push = new Float64Array(r);
  for (let i = 0; i < n; i++) {
    loaded(i);
    if (F[0] === 0 && F[1] === 0 && F[2] === 0) continue;
    if (state.model === "rsw") for (let k = 0; k < r; k++) for (let a = 0; a < 3; a++) push[k] += shapes[(3 * i + a) * r + k] * F[a];
    if (state.model === "mwts") {
      rowsTimes(psi, i, q, W);
      const s = W[0] * W[0] + W[1] * W[1] + W[2] * W[2], t = Math.sqrt(s), small = s < 1e-4;
      combination(W, F, 1, -(small ? 1 - s / 6 : Math.sin(t) / t), small ? 0.5 - s / 24 : (1 - Math.cos(t)) / s, T);
      F.set(T);
    }
    let at = 3 * i * m;
    for (let a = 0; a < 3; a++) for (let k = 0; k < m; k++) p[k] += phi[at++] * F[a];
  }
  if (state.model === "rsw") addBentForce(q, push, p);
}
// Divided differences of exp at both roots of z^2 + y z + x, and at none, one and two zeros more.
function differences(x, y) {
  if (x + y < 0.5) {
    const sums = [0, 0, 0];
    for (let k = 0, before = 0, term = 1, factorial = 1; k < 24; k++) {
      sums[0] += term / factorial; sums[1] += term / (factorial * (k + 2)); sums[2] += term / (factorial * (k + 2) * (k + 3));
      [before, term] = [term, -y * term - x * before];
      factorial *= k + 2;
    }
    return sums;
  }
  const half = 0.5 * y, squared = x - half * half, root = Math.sqrt(Math.abs(squared));
  if (x < 1e-2 * y) {
    const fast = -(half + root), slow = x / fast, share = f => (f(slow) - f(fast)) / (slow - fast);
    const once = z => z === 0 ? 1 : Math.expm1(z) / z;
    const twice = z => {
      if (Math.abs(z) >= 0.1) return (once(z) - 1) / z;
      let sum = 0;
      for (let k = 0, term = 0.5; k < 10; term *= z / (k + 3), k++) sum += term;
      return sum;
    };
    return [share(Math.exp), share(once), share(twice)];
  }
  const slow = Math.exp(-x / (half + root)), fast = Math.exp(-(half + root)), small = root < 1e-3;
  const sine = small ? Math.exp(-half) * (1 - squared / 6) : squared > 0 ? Math.exp(-half) * Math.sin(root) / root : (slow - fast) / (2 * root);
  const cosine = squared > 0 ? Math.exp(-half) * Math.cos(root) : 0.5 * (slow + fast), second = (1 - cosine - half * sine) / x;
  return [sine, second, (1 - sine - y * second) / x];
}
const kept = new Float64Array(m), pushed = new Float64Array(m);  // modal forces of the last step and of this one
let known = false, flow = {};
function flowOf(h, xi, zeta, turning) {  // of every mode: q, v after a step from q, v, the kept force and its change
  const outrun = (stiffness, count) => h * h * stiffness > (1 + 1e-6) * (2 * Math.PI / count) ** 2;
  const hardly = lambda.filter(stiffness => turning && outrun(stiffness, 4) && !outrun(stiffness, 3)), share = hardly.length ? 1 : 0.5;
  if (flow.h !== h || flow.xi !== xi || flow.zeta !== zeta || flow.turning !== turning)
    flow = {h, xi, zeta, turning, stiff: Math.min(...hardly), modes: lambda.map(stiffness => {
      const c = xi + zeta * stiffness, x = h * h * stiffness, y = h * c;
      if (turning && outrun(stiffness, 3)) {  // implicit Euler: forces that turn feed unresolved modes
        const whole = 1 + y + x, push = h / whole;
        return [(1 + y) / whole, push, h * push, share * h * push, -stiffness * push, 1 / whole, push, share * push];
      }
      const [first, second, third] = differences(x, y);
      return [1 - x * second, h * first, h * h * second, h * h * third, -stiffness * h * first, 1 - x * second - y * first, h * first, h * second];
    })};
  return flow.modes;
}
function step() {  // the exponential rule [hochbruck2010]
  const {q, v} = state, modes = flowOf(live.dt, state.xi, state.zeta, state.model !== "lma");
  if (!known) modalForce(q, kept);
  const begin = free && [q.slice(), v.slice()];
  for (let k = 0; k < m; k++) {
    const [e11, e12, a1, , e21, e22, b1] = modes[k], before = q[k];
    q[k] = e11 * before + e12 * v[k] + a1 * kept[k]; v[k] = e21 * before + e22 * v[k] + b1 * kept[k];
    if (k >= state.count && k >= rigid) q[k] = v[k] = 0;
  }
  modalForce(free ? turnedBack(q.slice(), live.dt) : q, pushed);
  let missed = 0;
  for (let k = 0; k < Math.max(state.count, rigid); k++) {
    const change = pushed[k] - kept[k];
    q[k] += modes[k][3] * change; v[k] += modes[k][7] * change;
    missed += (modes[k][3] * change) ** 2;
  }
  const strong = pushed.reduce((sum, push, k) => lambda[k] > 0 && k < state.count ? sum + push * push : sum, 0);
  if (missed > live.violent || strong > live.violent * flow.stiff ** 2) modalForce(free ? turnedBack(q.slice(), live.dt) : q, pushed);
  if (free) fly(...begin, kept, pushed);
  kept.set(pushed);
  known = true;
  state.time += live.dt;
}
function steps(count) { for (let i = 0; i < count; i++) step(); }
function relax(h, xi) {  // a step of implicit Euler
  modalForce(state.q, pushed);
  for (let k = 0; k < m; k++) {
    if (k < rigid) continue;  // frames rest
    if (k >= state.count) { state.q[k] = state.v[k] = 0; continue; }
    const c = xi + state.zeta * lambda[k];
    state.v[k] = (state.v[k] + h * (pushed[k] - lambda[k] * state.q[k])) / (1 + h * c + h * h * lambda[k]);
    state.q[k] += h * state.v[k];
  }
  state.time += h;
}
function settle() {  // heavily damped steps to a standstill; whether they came to one
  const soft = Math.max(...lambda.slice(0, state.count).filter(x => x > 0).slice(0, 1), 1e-12), root = Math.sqrt(soft);
  state.v.fill(0);
  known = false;
  if (free) flying.forEach(part => part.back.fill(0));
  for (let i = 0; i < 4000; i++) {
    const before = state.q.slice();
    relax(1 / root, 2 * root);
    let change = 0, size = 1e-300;
    for (let k = 0; k < m; k++) {
      change += lambda[k] * (state.q[k] - before[k]) ** 2; size += lambda[k] * state.q[k] ** 2;
    }
    if (change < 1e-16 * size) { state.v.fill(0); return true; }
  }
  return false;
}
function release() { state.q.fill(0); state.v.fill(0); state.time = 0; known = false; if (free) flying.forEach(part => part.back.fill(0)); }
function positions(q = state.q) {
  return state.model === "scene" ? scenePositions() : free ? inWorld(q) : shapeOf(q);
}
function shapeOf(q) {
  const out = new Float64Array(3 * n), x = new Float64Array(3);
  bend(q);
  for (let i = 0; i < n; i++) { position(i, q, x); out.set(x, 3 * i); }
  return out;
}
function area(x) {
  let sum = 0;
  for (let t = 0; t < faces.length; t += 3) {
    const a = 3 * faces[t], b = 3 * faces[t + 1], c = 3 * faces[t + 2];
    const ux = x[b] - x[a], uy = x[b + 1] - x[a + 1], uz = x[b + 2] - x[a + 2];
    const vx = x[c] - x[a], vy = x[c + 1] - x[a + 1], vz = x[c + 2] - x[a + 2];
    sum += 0.5 * Math.hypot(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx);
  }
  return sum;
}
const restArea = area(rest);
