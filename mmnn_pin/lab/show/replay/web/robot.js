/** Where the bodies of a robot are in the world at a position: one THREE.Matrix4 per body, written to `out`. */
function placeBodies(THREE, robot, position, out) {
  const motion = new THREE.Matrix4(), axis = new THREE.Vector3();
  robot.bodies.forEach((body, i) => {
    if (body.parent < 0) {
      out[i].copy(placeRoot(THREE, robot, position));
      return;
    }
    const travel = position[body.column];
    axis.fromArray(body.axis);
    if (body.kind === "prismatic") motion.makeTranslation(...axis.multiplyScalar(travel).toArray());
    else motion.makeRotationAxis(axis, travel);
    out[i].fromArray(body.origin).premultiply(out[body.parent]).multiply(motion);
  });
  return out;
}

/** The root link: the control frame's pose, less where that frame lies in the root link. */
function placeRoot(THREE, robot, position) {
  const [x, y, turn, floor] = robot.frame;
  const own = new THREE.Matrix4().makeRotationZ(turn).setPosition(x, y, floor).invert();
  if (!robot.mobile) return own;
  return new THREE.Matrix4().makeRotationZ(position[2]).setPosition(position[0], position[1], 0).multiply(own);
}

/** A robot in the scene. `style` makes the material of a visual from its colour. */
class RobotView {
  constructor(THREE, robot, geometries, style) {
    this.THREE = THREE;
    this.robot = robot;
    this.group = new THREE.Group();
    this.bodies = robot.bodies.map(() => {
      const body = new THREE.Group();
      body.matrixAutoUpdate = false;
      this.group.add(body);
      return body;
    });
    for (const visual of robot.visuals) {
      for (const mesh of style(geometries[visual.geometry], visual.color)) {
        mesh.matrixAutoUpdate = false;
        mesh.matrix.fromArray(visual.place);
        this.bodies[visual.body].add(mesh);
      }
    }
    this.matrices = this.bodies.map((body) => body.matrix);
  }

  set(position) {
    placeBodies(this.THREE, this.robot, position, this.matrices);
    for (const body of this.bodies) body.matrixWorldNeedsUpdate = true;
  }

  /** Colour bodies, all for an empty list; null gives them their own colours back. */
  glow(color, bodies) {
    const chosen = bodies.length ? bodies.map((i) => this.bodies[i]) : this.bodies;
    for (const { material, userData } of chosen.flatMap((body) => body.children)) {
      material.color.copy(color === null ? userData.color : flat(this.THREE, color));
    }
  }
}

/** A colour (0xRRGGBB, or a text of CSS) as three.js computes with it. */
function flat(THREE, color) {
  return new THREE.Color(color).convertSRGBToLinear();
}

/** The same for red, green and blue in [0, 1]. */
function linear(THREE, rgb) {
  return new THREE.Color(rgb[0], rgb[1], rgb[2]).convertSRGBToLinear();
}

/** Solid robots; with a tint they keep only their shades. Earlier runs lie before later ones in the same place. */
function solidStyle(THREE, tint, order) {
  return (geometry, rgba) => {
    const shade = 0.3 * rgba[0] + 0.59 * rgba[1] + 0.11 * rgba[2];
    const color = tint ? linear(THREE, tint).lerp(linear(THREE, [shade, shade, shade]), 0.25) : linear(THREE, rgba);
    const seeThrough = rgba[3] < 1;
    const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({
      color, roughness: 0.65, metalness: 0.05, transparent: seeThrough, opacity: rgba[3], depthWrite: !seeThrough,
      polygonOffset: order > 0, polygonOffsetFactor: order, polygonOffsetUnits: order,
    }));
    mesh.userData.color = color;
    mesh.castShadow = !seeThrough;
    mesh.receiveShadow = true;
    return [mesh];
  };
}

const EDGES = new WeakMap(); // the outlines of geometries, each made once

function edgesOf(THREE, geometry) {
  if (!EDGES.has(geometry)) EDGES.set(geometry, new THREE.EdgesGeometry(geometry, 40));
  return EDGES.get(geometry);
}

/** The ghost: its outer surface, translucent, behind whatever is in the same place; its edges are seen there, too. */
function ghostStyle(THREE, color) {
  const offset = { polygonOffset: true, polygonOffsetFactor: 4, polygonOffsetUnits: 4 };
  const depth = new THREE.MeshBasicMaterial({ colorWrite: false, transparent: true, ...offset });
  const tint = new THREE.MeshStandardMaterial({
    color: flat(THREE, color), roughness: 1, transparent: true, opacity: 0.4, depthWrite: false, ...offset,
  });
  const line = new THREE.LineBasicMaterial({ color: flat(THREE, color), transparent: true, opacity: 0.8 });
  return (geometry) => {
    const parts = [depth, tint].map((material) => new THREE.Mesh(geometry, material));
    parts.push(new THREE.LineSegments(edgesOf(THREE, geometry), line));
    parts.forEach((part, i) => { part.renderOrder = 1 + i; });
    return parts;
  };
}
