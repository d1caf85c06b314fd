const EVENT_COLORS = { stop: 0xe03024, slip: 0x9b3fd0, limit: 0xf0a020 } /* the worst first */;
const REFERENCE = { light: "#5b5bd6", dark: "#a3a3ff" }; // of the ghost and of its paths, which are dashed; no run has it
const DASH = 0.07;
const LONGEST_TRACE = 4000; // points

/** The colour of what was asked for. */
function referenceColor() {
  return REFERENCE[isDark() ? "dark" : "light"];
}

/** One recorded run: its robot, its ghost, its paths, and where they are at a time. */
class RunView {
  constructor(THREE, run, robot, geometries, { several, order }) {
    Object.assign(this, { THREE, run, robot, order });
    this.group = new THREE.Group();
    this.color = isDark() ? run.dark : run.color;
    const rgb = this.rgb = [1, 3, 5].map((i) => parseInt(this.color.slice(i, i + 2), 16) / 255);
    this.view = new RobotView(THREE, robot, geometries, solidStyle(THREE, several ? rgb : null, order));
    this.group.add(this.view.group);
    this.now = new Float32Array(run.width);
    this.duration = run.time[run.frames - 1];
    this.events = run.events.map((event) =>
      ({ ...event, start: Math.min(event.start, this.duration), end: event.end ?? Infinity }));
    this.twins = []; // earlier runs with the same reference
    this.layers = { reference: [], wanted: [], paths: [], traces: [], frames: [] };
    this.growing = [];
    this.step = Math.ceil(run.frames / LONGEST_TRACE);
    if (run.reference) {
      this.ghost = new RobotView(THREE, robot, geometries, ghostStyle(THREE, referenceColor()));
      this.wished = new Float32Array(run.width);
      this.add("reference", this.ghost.group);
    }
    this.hands = (run.hands ?? []).map((hand) => ({ ...hand, axes: axesOf(THREE, 1), wish: axesOf(THREE, 0.35) }));
    for (const { axes, wish } of this.hands) for (const each of [wish, axes]) this.add("frames", each);
    if (run.touch) this.touch = new TouchView(THREE, run.touch, robot.frame[3], this.group);
  }

  /** The path and the traces of the tips, driven and wanted. */
  addLines(thickness) {
    const { THREE, run, robot } = this, color = linear(THREE, this.rgb), wide = (factor) => factor * thickness;
    const [driven, traced] = [0, 0.12].map((paler) =>
      new THREE.MeshBasicMaterial({ color: color.clone().lerp(new THREE.Color(1, 1, 1), paler) }));
    const wish = new THREE.MeshBasicMaterial({ color: flat(THREE, referenceColor()) });
    const want = (points, half) => this.addBand("wanted", points, half.map(wide), wish, wide(DASH));
    const grow = (layer, points, half, material) => this.growing.push(this.addBand(layer, points, half.map(wide), material));
    const above = wide(0.006 + 0.001 * this.order);
    if (robot.mobile) grow("paths", this.ground(run.position, above), [0.011, 0.0008], driven);
    const tips = this.hands.length ? [] : robot.tips; // a hand's own frame is traced in the place of the arm's tip
    for (const tip of tips) grow("traces", this.trace(run.position, tip), [0.005, 0.005], traced);
    for (const { pose, wanted, axes, wish: small } of this.hands) {
      grow("traces", this.drawn(pose), [0.005, 0.005], traced);
      want(this.drawn(wanted), [0.003, 0.003]);
      for (const each of [axes, small]) each.scale.setScalar(wide(0.12));
    }
    if (!run.reference) return;
    if (robot.mobile) want(this.ground(run.reference, wide(0.004)), [0.02, 0.0004]);
    for (const tip of tips) want(this.trace(run.reference, tip), [0.003, 0.003]);
  }

  add(layer, object) {
    this.layers[layer].push(object);
    this.group.add(object);
  }

  addBand(layer, points, half, material, dash) {
    const band = makeBand(this.THREE, points, half, material, dash);
    this.add(layer, band);
    return band;
  }

  /** Path of the control frame on the floor, (k, 3). */
  ground(table, height) {
    const { width } = this.run, points = [];
    for (let i = 0; i < table.length; i += width * this.step) points.push(table[i], table[i + 1], height);
    return points;
  }

  /** The path of a hand's poses (k, 7), above the floor, (k, 3). */
  drawn(poses) {
    const points = [], floor = this.robot.frame[3];
    for (let i = 0; i < poses.length; i += 7 * this.step) points.push(poses[i], poses[i + 1], poses[i + 2] - floor);
    return points;
  }

  /** Put axes where a hand's poses (k, 7) have them between two frames. */
  place(axes, poses, low, high, share) {
    const turned = (frame) => new this.THREE.Quaternion().fromArray(poses, 7 * frame + 3);
    const [x, y, z] = [0, 1, 2].map((i) => poses[7 * low + i] + share * (poses[7 * high + i] - poses[7 * low + i]));
    axes.position.set(x, y, z - this.robot.frame[3]);
    axes.quaternion.copy(turned(low).slerp(turned(high), share));
  }

  /** Where the tips are, done and wanted, (k, 3) each. */
  tips() {
    const tables = [this.run.position, this.run.reference].filter(Boolean);
    return this.robot.tips.flatMap((tip) => tables.map((table) => this.trace(table, tip)));
  }

  /** Where a tip is at every frame, (k, 3). */
  trace(table, tip) {
    const { width } = this.run, points = [], matrices = this.robot.bodies.map(() => new this.THREE.Matrix4());
    for (let i = 0; i < table.length; i += width * this.step) {
      placeBodies(this.THREE, this.robot, table.subarray(i, i + width), matrices);
      points.push(...new this.THREE.Vector3(...tip.point).applyMatrix4(matrices[tip.body]).toArray());
    }
    return points;
  }

  /** Show a time: between two frames all positions are interpolated (angles are unwrapped). */
  set(time) {
    const { run } = this, last = run.frames - 1;
    let low = 0, high = last;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (run.time[middle] <= time) low = middle; else high = middle;
    }
    const gap = run.time[high] - run.time[low];
    const share = gap > 0 ? Math.min(Math.max((time - run.time[low]) / gap, 0), 1) : 0;
    blend(run.position, low, high, share, run.width, this.now);
    this.view.set(this.now);
    if (this.ghost) {
      blend(run.reference, low, high, share, run.width, this.wished);
      this.ghost.set(this.wished);
    }
    for (const { pose, wanted, axes, wish } of this.hands) {
      this.place(axes, pose, low, high, share);
      this.place(wish, wanted, low, high, share);
    }
    if (this.touch) this.touch.set(low, high, share);
    const seen = share < 1 ? low : high;
    for (const band of this.growing) {
      const ends = band.userData.ends;
      band.geometry.setDrawRange(0, ends[Math.min(Math.floor(seen / this.step), ends.length - 1)]);
    }
    return this.happening(time);
  }

  /** Colour what happens at a time, and return it. */
  happening(time) {
    const here = this.events.filter((event) => event.start <= time && time <= event.end);
    const key = here.map((event) => event.text).join();
    if (key !== this.coloured) {
      this.coloured = key;
      this.view.glow(null, []);
      for (const [kind, color] of Object.entries(EVENT_COLORS).reverse()) {
        for (const event of here) if (event.kind === kind) this.view.glow(color, event.bodies);
      }
    }
    return here;
  }
}

/** What a hand touches, and the force on the hand as an arrow of 1 cm for a newton. */
class TouchView {
  constructor(THREE, touch, floor, group) {
    Object.assign(this, { THREE, touch, floor });
    const red = { color: flat(THREE, 0xd8372c), depthTest: false, transparent: true };
    const look = new THREE.MeshLambertMaterial({ color: flat(THREE, 0xb08a5a), transparent: true, opacity: 0.55 });
    this.arrow = new THREE.Group();
    this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.012, 0.012, 1, 12), new THREE.MeshBasicMaterial(red));
    this.head = new THREE.Mesh(new THREE.ConeGeometry(0.032, 0.07, 16), new THREE.MeshBasicMaterial(red));
    this.arrow.add(this.shaft, this.head);
    for (const each of [this.shaft, this.head]) each.renderOrder = 6;
    group.add(this.arrow);
    const up = new THREE.Vector3(0, 0, 1);
    for (const { point, normal } of touch.surfaces) {
      const slab = new THREE.Mesh(new THREE.BoxGeometry(1.6, 1.0, 0.03), look);
      const facing = new THREE.Vector3(...normal);
      slab.quaternion.setFromUnitVectors(up, facing);
      slab.position.set(point[0] + 0.3, point[1], point[2] - floor).addScaledVector(facing, -0.015);
      slab.receiveShadow = true;
      group.add(slab);
    }
    if (touch.door) {
      const [x, y] = touch.door.handle, width = Math.hypot(x, y) + 0.08, height = touch.door.hinge[2] - floor;
      const panel = new THREE.Mesh(new THREE.BoxGeometry(width, 0.035, height + 0.9), look);
      panel.position.set(width / 2, 0, (0.9 - height) / 2);
      panel.castShadow = true;
      this.door = new THREE.Group();
      this.door.add(panel);
      this.door.position.set(touch.door.hinge[0], touch.door.hinge[1], height);
      group.add(this.door);
    }
  }

  set(low, high, share) {
    const { forces, door } = this.touch, at = [0, 1, 2, 3, 4, 5].map((i) => forces[6 * low + i] + share * (forces[6 * high + i] - forces[6 * low + i]));
    const force = new this.THREE.Vector3(...at.slice(3)), length = 0.01 * force.length();
    this.arrow.visible = length > 0.005;
    this.arrow.position.set(at[0], at[1], at[2] - this.floor);
    this.arrow.quaternion.setFromUnitVectors(new this.THREE.Vector3(0, 1, 0), force.normalize());
    this.shaft.scale.y = Math.max(length, 1e-6);
    this.shaft.position.y = length / 2;
    this.head.position.y = length + 0.03;
    if (this.door) this.door.rotation.z = Math.atan2(door.handle[2 * low + 1], door.handle[2 * low]);
  }
}

/** The axes of a frame, a unit long: x red, y green, z blue; they are seen through what is before them. */
function axesOf(THREE, opacity) {
  const axes = new THREE.Group();
  [0xe0403a, 0x2fa84f, 0x3b6fe0].forEach((color, i) => {
    const size = [0, 1, 2].map((k) => (k === i ? 1 : opacity < 1 ? 0.03 : 0.05));
    const look = { color: flat(THREE, color), transparent: true, opacity, depthTest: false };
    const bar = new THREE.Mesh(new THREE.BoxGeometry(...size), new THREE.MeshBasicMaterial(look));
    bar.position.setComponent(i, 0.5);
    bar.renderOrder = 5;
    axes.add(bar);
  });
  return axes;
}

function blend(table, low, high, share, width, out) {
  for (let i = 0; i < width; i++) {
    const from = table[low * width + i];
    out[i] = from + share * (table[high * width + i] - from);
  }
}
