// A lat-long map on a ball that can be turned, or around the viewer. +y is up; azimuth goes from +x towards +z.

/** Columns of the matrix from the viewer's axes (right, up, towards the viewer) to the world's. */
function turnMatrix(yaw, pitch) {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const towards = [cp * sy, sp, cp * cy];
  const right = [cy, 0, -sy];
  const up = [-sp * sy, cp, -sp * cy];
  return [...right, ...up, ...towards];
}

/** The direction of a point of a map, in parts of its width and height. */
function directionOf(u, v) {
  const [phi, theta] = [2 * Math.PI * u, Math.PI * v];
  return [Math.sin(theta) * Math.cos(phi), Math.cos(theta), Math.sin(theta) * Math.sin(phi)];
}

/** Where a point of a map is seen in a panel; null where it is on the other side. */
function placeOnSphere(u, v, shape, turn, panel, scale) {
  const d = directionOf(u, v);
  const [x, y, z] = [0, 3, 6].map((at) => turn[at] * d[0] + turn[at + 1] * d[1] + turn[at + 2] * d[2]);
  const radius = 0.5 * Math.min(panel.width, panel.height) * scale;
  if (shape === 1) return z < 0 ? null : [panel.width / 2 + radius * x, panel.height / 2 - radius * y];
  return z > -0.05 ? null : [panel.width / 2 - (radius * x) / z, panel.height / 2 + (radius * y) / z];
}

/** The point of a map under a place in a panel, in parts of its width and height; null beside the ball. */
function pointOfSphere(x, y, shape, turn, panel, scale) {
  const radius = 0.5 * Math.min(panel.width, panel.height) * scale;
  const [qx, qy] = [(x - panel.width / 2) / radius, -(y - panel.height / 2) / radius];
  const square = qx * qx + qy * qy;
  if (shape === 1 && square > 1) return null;
  const n = shape === 1 ? [qx, qy, Math.sqrt(1 - square)] : [qx, qy, -1].map((value) => value / Math.sqrt(square + 1));
  const d = [0, 1, 2].map((row) => turn[row] * n[0] + turn[3 + row] * n[1] + turn[6 + row] * n[2]);
  const u = Math.atan2(d[2], d[0]) / (2 * Math.PI);
  return [u - Math.floor(u), Math.acos(Math.min(1, Math.max(-1, d[1]))) / Math.PI];
}
