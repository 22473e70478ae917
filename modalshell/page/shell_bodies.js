// ---- what the shell touches: rigid bodies, with a rotation by rows and a way in each frame of the record ----
const bodies = (data.bodies || []).map(body => ({
  rest: new Float32Array(bytes(body.rest)), faces: new Uint32Array(bytes(body.faces)), poses: new Float32Array(bytes(body.poses)),
}));
const bodyFrame = {first: 0, share: 0};
let bodyProgram = null;
function bodyPrograms() {
  if (!bodies.length) return;
  bodyProgram = program(`
uniform mat4 camera; uniform mat3 turn; uniform vec3 way; in vec3 rest; out vec3 place;
void main() { place = turn * rest + way; gl_Position = camera * vec4(place, 1.0); }`, shaded("vec3 tone() { return vec3(0.72, 0.71, 0.69); }"));
  for (const body of bodies) body.mesh = surface(bodyProgram.made, body.rest, body.faces);
}
function drawBodies() {
  if (!bodies.length) return;
  const use = bodyProgram.places, {first, share} = bodyFrame;
  gl.useProgram(bodyProgram.made);
  gl.uniformMatrix4fv(use.camera, false, cameraMatrix());
  gl.uniform3fv(use.towards, axes()[2]);
  for (const {mesh, faces, poses} of bodies) {
    const last = poses.length / 12 - 1, here = 12 * Math.min(first, last), after = 12 * Math.min(first + 1, last);
    const pose = Array.from({length: 12}, (_, i) => (1 - share) * poses[here + i] + share * poses[after + i]);
    gl.uniformMatrix3fv(use.turn, true, pose.slice(0, 9));
    gl.uniform3fv(use.way, pose.slice(9));
    gl.bindVertexArray(mesh);
    gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
  }
}
