// ---- parts that no support holds: each flies in a frame of its own, its shape about its centre, as the models' do ----
const flying = free.parts.map(part => {
  const vertices = new Uint32Array(bytes(part)), centre = [0, 0, 0];
  let total = 0;
  for (const i of vertices) { total += mass[i]; for (let a = 0; a < 3; a++) centre[a] += mass[i] * rest[3 * i + a]; }
  return {vertices, total, centre: centre.map(x => x / total), back: [0, 0, 0]};
});
const AXES = [0, 1, 2], none = () => [0, 0, 0];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b, scale = 1) => AXES.map(i => a[i] + scale * b[i]);
const vectorAt = (x, i) => [x[3 * i], x[3 * i + 1], x[3 * i + 2]];
// Matrices are nine numbers, row by row.
const applied = (M, v) => AXES.map(i => M[3 * i] * v[0] + M[3 * i + 1] * v[1] + M[3 * i + 2] * v[2]);
const transposed = M => [0, 3, 6, 1, 4, 7, 2, 5, 8].map(i => M[i]);
const product = (A, B) => AXES.flatMap(i => AXES.map(j => A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j]));
const inertiaOf = moments => {
  const trace = moments[0] + moments[4] + moments[8];
  return moments.map((x, i) => (i % 4 ? 0 : trace) - x);
};
const axial = M => [M[7] - M[5], M[2] - M[6], M[3] - M[1]];
function solved(M, b) {  // by Cramer's rule
  const [r, s, t] = AXES.map(i => M.slice(3 * i, 3 * i + 3)), st = cross(s, t), tr = cross(t, r), rs = cross(r, s);
  const determinant = r[0] * st[0] + r[1] * st[1] + r[2] * st[2];
  return AXES.map(i => (b[0] * st[i] + b[1] * tr[i] + b[2] * rs[i]) / determinant);
}
function ofVector(w, averaged) {  // exp([w]), or its average from 0 to w, which takes rates of w to angular velocities
  const s = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], t = Math.sqrt(s), small = s < 1e-2;
  const c2 = small ? 0.5 - s / 24 * (1 - s / 30 * (1 - s / 56)) : (1 - Math.cos(t)) / s;
  const c3 = small ? 1 / 6 - s / 120 * (1 - s / 42 * (1 - s / 72)) : (t - Math.sin(t)) / (s * t);
  const [first, second] = averaged ? [c2, c3] : [1 - s * c3, c2], [x, y, z] = w, turning = [0, -z, y, z, 0, -x, -y, x, 0];
  return turning.map((part, at) => {
    const i = Math.floor(at / 3), j = at % 3;
    return first * part + second * w[i] * w[j] + (i === j ? 1 - second * s : 0);
  });
}
function toVector(R) {  // of at most half a turn, by the largest part of the quaternion
  const trace = R[0] + R[4] + R[8], squares = [...AXES.map(i => 1 + 2 * R[4 * i] - trace), 1 + trace];
  const largest = squares.indexOf(Math.max(...squares)), root = Math.sqrt(squares[largest]), scale = 0.5 / root, out = none();
  let scalar = 0.5 * root;
  if (largest === 3) axial(R).forEach((x, i) => { out[i] = scale * x; });
  else {
    const i = largest, j = (i + 1) % 3, k = (i + 2) % 3;
    scalar = scale * (R[3 * k + j] - R[3 * j + k]);
    out[i] = 0.5 * root; out[j] = scale * (R[3 * j + i] + R[3 * i + j]); out[k] = scale * (R[3 * k + i] + R[3 * i + k]);
  }
  const length = Math.hypot(...out), factor = length > 1e-12 ? 2 * Math.atan2(length, Math.abs(scalar)) / length : 2;
  return out.map(x => (scalar >= 0 ? factor : -factor) * x);
}
// The rotation F, near that of a guess, with sum m a x F b = impulse, for moments sum m b a^T [moser1991]; null without.
function keepingTurn(moments, impulse, guess) {
  const size = Math.hypot(...moments);
  let turn = ofVector(guess), last = Infinity;
  for (let k = 0; k < 40; k++) {
    const turned = product(turn, moments), residual = plus(axial(turned), impulse, -1), missed = Math.hypot(...residual);
    if (missed <= 4e-16 * size || (missed <= 1e-12 * size && missed >= 0.5 * last)) return turn;
    last = missed;
    const change = solved(inertiaOf(turned), residual);
    if (!(Math.hypot(...change) < 1)) return null;
    turn = product(ofVector(change.map(x => -x)), turn);
  }
  return last <= 1e-12 * size ? turn : null;
}
function momentsOf(part, a, b) {  // sum m b a^T of two shapes
  const out = new Array(9).fill(0);
  for (const i of part.vertices) for (let j = 0; j < 3; j++) for (let k = 0; k < 3; k++)
    out[3 * j + k] += mass[i] * b[3 * i + j] * a[3 * i + k];
  return out;
}
function aboutMeans(x) {  // every free part about its own mean
  for (const {vertices, total} of flying) for (let a = 0; a < 3; a++) {
    let mean = 0;
    for (const i of vertices) mean += mass[i] * x[3 * i + a];
    for (const i of vertices) x[3 * i + a] -= mean / total;
  }
  return x;
}
const timesRows = (rows, x) => rows.map(row => row.reduce((sum, value, k) => sum + value * x[k], 0));
function elasticOf(q) {  // coordinates or rates without those of the frames
  const own = Float64Array.from(q);
  own.set(timesRows(free.others, q));
  return own;
}
function posesOf(q) {  // a displacement and a rotation vector of each frame, or their rates
  const all = timesRows(free.to, q);
  return flying.map((_, at) => [all.slice(6 * at, 6 * at + 3), all.slice(6 * at + 3, 6 * at + 6)]);
}
function addPoses(q, poses, scale = 1) { timesRows(free.from, poses.flat(2)).forEach((x, k) => { q[k] += scale * x; }); }
const spinsOf = (q, rates) => posesOf(rates).map(([, speed], at) => applied(ofVector(posesOf(q)[at][1].map(x => -x), true), speed));
function inWorld(q) {
  const x = aboutMeans(shapeOf(elasticOf(q))), poses = posesOf(q);
  flying.forEach(({vertices, centre}, at) => {
    const turn = ofVector(poses[at][1]), way = plus(centre, poses[at][0]);
    for (const i of vertices) x.set(plus(applied(turn, vectorAt(x, i)), way), 3 * i);
  });
  return x;
}
const turnedBack = (q, h) => {  // where frames are expected, which also turn back what the shape turns
  if (flying.some(part => part.back.some(Boolean))) addPoses(q, flying.map(part => [none(), part.back]), h);
  return q;
};
function speedsOf(q, rates, lead) {  // of the shape, in frames that turn with its mean motion
  const own = elasticOf(q), slow = elasticOf(rates), x = shapeOf(own);
  const before = shapeOf(own.map((value, k) => value - lead * slow[k])), v = aboutMeans(x.map((value, i) => (value - before[i]) / lead));
  aboutMeans(x);
  for (const part of flying) {
    const turning = solved(inertiaOf(momentsOf(part, x, x)), axial(momentsOf(part, x, v)));
    for (const i of part.vertices) v.set(plus(vectorAt(v, i), cross(turning, vectorAt(x, i)), -1), 3 * i);
  }
  return v;
}
// Loads in the frames less their mean acceleration, with the inertial loads of frames that turn; into p those of the
// modes, on the rigid modes the forces and torques.
function freeForce(q, rates, p) {
  const own = new Float64Array(3 * n), poses = posesOf(q), spins = spinsOf(q, rates), x = aboutMeans(shapeOf(elasticOf(q)));
  for (let i = 0; i < n; i++) { loadOn(i); own.set(F, 3 * i); }
  const forces = flying.map(({vertices, total}, at) => {
    const whole = none(), turn = ofVector(poses[at][1]), back = transposed(turn);
    let torque = none(), largest = 0, uneven = 0;
    for (const i of vertices) for (let a = 0; a < 3; a++) whole[a] += own[3 * i + a];
    for (const i of vertices) for (let a = 0; a < 3; a++) {
      largest = Math.max(largest, Math.abs(own[3 * i + a]));
      own[3 * i + a] -= mass[i] / total * whole[a];
      uneven = Math.max(uneven, Math.abs(own[3 * i + a]));
    }
    for (const i of vertices) {
      own.set(uneven <= 1e-13 * largest ? none() : applied(back, vectorAt(own, i)), 3 * i);
      torque = plus(torque, cross(vectorAt(x, i), vectorAt(own, i)));
    }
    return [whole, applied(turn, torque)];
  });
  const turns = spins.flat().some(Boolean);
  if (turns || forces.some(([, torque]) => torque.some(Boolean))) {
    const v = turns ? speedsOf(q, rates, free.lead * live.dt) : own.map(() => 0);
    flying.forEach((part, at) => {
      const spin = spins[at], inertia = inertiaOf(momentsOf(part, x, x));
      const twist = applied(transposed(ofVector(poses[at][1])), forces[at][1]);
      const faster = solved(inertia, plus(twist, cross(spin, applied(inertia, spin)), -1));
      for (const i of part.vertices) {
        const arm = vectorAt(x, i), along = plus(cross(spin, arm), vectorAt(v, i), 2);
        own.set(plus(vectorAt(own, i), plus(cross(faster, arm), cross(spin, along)), -mass[i]), 3 * i);
      }
    });
  }
  warpedForce(elasticOf(q), p, i => { F.set(own.subarray(3 * i, 3 * i + 3)); });
  const all = forces.flat(2), slack = timesRows(free.others, p);
  for (let k = 0; k < rigid; k++) p[k] = slack[k] + all.reduce((sum, value, row) => sum + free.to[row][k] * value, 0);
}
// The end of a step from coordinates and rates, its frames where forces and torques at both ends bring them.
function fly(before, rates, first, last) {
  const h = live.dt, y = h * state.xi, [once, second, third] = differences(0, y), {q, v} = state;
  const x0 = aboutMeans(shapeOf(elasticOf(before))), x1 = aboutMeans(shapeOf(elasticOf(q)));
  const poses = posesOf(before), speeds = posesOf(rates), spins = spinsOf(before, rates);
  const wrenches = p => {
    const all = free.from[0].map((_, at) => free.from.reduce((sum, row, k) => sum + row[at] * p[k], 0));
    return flying.map((_, at) => [all.slice(6 * at, 6 * at + 3), all.slice(6 * at + 3, 6 * at + 6)]);
  };
  const begins = wrenches(first), ends = wrenches(last);
  flying.forEach((part, at) => {
    const turn = ofVector(poses[at][1]), inertia = inertiaOf(momentsOf(part, x0, x0));
    const momenta = [speeds[at][0].map(u => part.total * u), applied(turn, applied(inertia, spins[at]))];
    const change = AXES.slice(0, 2).map(i => plus(ends[at][i], begins[at][i], -1));
    const moved = momenta.map((p, i) => AXES.map(a => h * once * p[a] + h * h * (second * begins[at][i][a] + third * change[i][a])));
    const after = momenta.map((p, i) => AXES.map(a => (1 - y * once) * p[a] + h * (once * begins[at][i][a] + second * change[i][a])));
    const impulse = applied(transposed(turn), moved[1]), guess = solved(inertia, impulse);
    const step = keepingTurn(momentsOf(part, x0, x1), impulse, guess) || ofVector(guess);
    const turned = product(turn, step), vector = toVector(turned), rate = ofVector(vector.map(x => -x), true);
    const spin = solved(inertiaOf(momentsOf(part, x1, x1)), applied(transposed(turned), after[1]));
    part.back = solved(rate, AXES.map(a => toVector(step)[a] / h - 0.5 * (spins[at][a] + spin[a])));
    poses[at] = [plus(poses[at][0], moved[0], 1 / part.total), vector];
    speeds[at] = [after[0].map(p => p / part.total), solved(rate, spin)];
  });
  for (const [values, own] of [[q, poses], [v, speeds]]) { values.set(elasticOf(values)); addPoses(values, own); }
}
