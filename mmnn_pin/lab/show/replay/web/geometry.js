const CREASE = Math.cos(Math.PI / 6); // edges sharper than this stay sharp

/** A three.js geometry of what the data tells; z is a cylinder's axis, as in URDF. */
function makeGeometry(THREE, shape) {
  const size = shape.size;
  if (shape.kind === "box") return new THREE.BoxGeometry(...size);
  if (shape.kind === "sphere") return new THREE.SphereGeometry(size[0], 32, 20);
  if (shape.kind === "cylinder") return new THREE.CylinderGeometry(size[0], size[0], size[1], 40).rotateX(Math.PI / 2);
  const points = Float32Array.from(shape.points, (steps, i) => shape.corner[i % 3] + steps * shape.step[i % 3]);
  const { position, normal } = creased(points, shape.triangles);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(normal, 3));
  return geometry;
}

/** Triangles with a normal per corner: smooth over the surface, broken at sharp edges. */
function creased(points, triangles) {
  const across = crossProducts(points, triangles);
  const unit = across.slice();
  for (let f = 0; f < unit.length; f += 3) {
    const length = Math.hypot(unit[f], unit[f + 1], unit[f + 2]) || 1;
    for (let k = 0; k < 3; k++) unit[f + k] /= length;
  }
  const { start, faces } = facesOfVertices(points.length / 3, triangles);
  const position = new Float32Array(3 * triangles.length), normal = new Float32Array(3 * triangles.length);
  triangles.forEach((vertex, corner) => {
    const own = 3 * Math.floor(corner / 3);
    let x = 0, y = 0, z = 0;
    for (let i = start[vertex]; i < start[vertex + 1]; i++) {
      const f = 3 * faces[i];
      if (unit[own] * unit[f] + unit[own + 1] * unit[f + 1] + unit[own + 2] * unit[f + 2] >= CREASE || f === own) {
        x += across[f]; y += across[f + 1]; z += across[f + 2];
      }
    }
    const length = Math.hypot(x, y, z) || 1;
    normal.set([x / length, y / length, z / length], 3 * corner);
    for (let k = 0; k < 3; k++) position[3 * corner + k] = points[3 * vertex + k];
  });
  return { position, normal };
}

/** Normal of every triangle, as long as twice its area. */
function crossProducts(points, triangles) {
  const across = new Float32Array(triangles.length);
  for (let f = 0; f < triangles.length; f += 3) {
    const [a, b, c] = [3 * triangles[f], 3 * triangles[f + 1], 3 * triangles[f + 2]];
    const ux = points[b] - points[a], uy = points[b + 1] - points[a + 1], uz = points[b + 2] - points[a + 2];
    const vx = points[c] - points[a], vy = points[c + 1] - points[a + 1], vz = points[c + 2] - points[a + 2];
    across[f] = uy * vz - uz * vy;
    across[f + 1] = uz * vx - ux * vz;
    across[f + 2] = ux * vy - uy * vx;
  }
  return across;
}

/** The triangles around every vertex: faces[start[v]] to faces[start[v + 1]]. */
function facesOfVertices(vertices, triangles) {
  const start = new Uint32Array(vertices + 1), faces = new Uint32Array(triangles.length);
  for (const v of triangles) start[v + 1]++;
  for (let v = 0; v < vertices; v++) start[v + 1] += start[v];
  const next = start.slice();
  triangles.forEach((v, corner) => { faces[next[v]++] = Math.floor(corner / 3); });
  return { start, faces };
}

/**
 * A band along points (k, 3): `half` its half width and half height; in pieces as long as a `dash` where that is given.
 * `ends[i]` indices draw the first i points.
 */
function makeBand(THREE, points, half, material, dash = Infinity) {
  const kept = [], drawn = [], ends = [];
  let length = 0, indices = 0;
  for (let i = 0; i < points.length; i += 3) {
    const here = new THREE.Vector3(points[i], points[i + 1], points[i + 2]);
    const gone = kept.length ? here.distanceTo(kept[kept.length - 1]) : 0;
    if (!kept.length || gone > half[0] / 4) {
      drawn.push(kept.length > 0 && Math.floor(length / dash) % 2 === 0);
      if (drawn[kept.length]) indices += 24;
      length += gone;
      kept.push(here);
    }
    ends.push(indices);
  }
  const corners = [], index = [];
  const along = new THREE.Vector3(), side = new THREE.Vector3(0, 1, 0), up = new THREE.Vector3(0, 0, 1);
  kept.forEach((here, i) => {
    along.subVectors(kept[Math.min(i + 1, kept.length - 1)], kept[Math.max(i - 1, 0)]);
    if (Math.hypot(along.x, along.y) > 1e-3 * along.length()) side.set(-along.y, along.x, 0).normalize();
    up.crossVectors(along, side).normalize();
    for (const [a, b] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
      corners.push(...here.clone().addScaledVector(side, a * half[0]).addScaledVector(up, b * half[1]).toArray());
    }
    for (let k = 0; drawn[i] && k < 4; k++) {
      const [a, b] = [4 * (i - 1) + k, 4 * (i - 1) + ((k + 1) % 4)];
      index.push(a, b, a + 4, b, b + 4, a + 4);
    }
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  geometry.setIndex(index);
  const band = new THREE.Mesh(geometry, material);
  band.frustumCulled = false;
  band.userData.ends = ends;
  return band;
}
