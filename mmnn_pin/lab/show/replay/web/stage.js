const FIELD = 38; // the camera's field of view [degrees]

/** The largest of 1, 2, 5 times a power of ten that is not above a length. */
function roundStep(length) {
  const decade = 10 ** Math.floor(Math.log10(length));
  return decade * (length >= 5 * decade ? 5 : length >= 2 * decade ? 2 : 1);
}

/** The multiples of a step from one multiple to another. */
function multiples(first, last, step) {
  return Array.from({ length: Math.round((last - first) / step) + 1 }, (_, i) => first + i * step);
}

/** Whether the page is dark: black is drawn as white then. */
function isDark() {
  return matchMedia("(prefers-color-scheme: dark)").matches;
}

/** Meshcat's viewer with our own light, ground and camera. Everything is added to `world`, whose z points up. */
class Stage {
  constructor(MeshCat, room) {
    const THREE = (this.THREE = MeshCat.THREE);
    this.viewer = new MeshCat.Viewer(document.getElementById("pane"));
    this.viewer.gui.domElement.remove();
    for (const path of ["Lights", "Grid", "Axes"]) this.viewer.delete_path([path]);
    this.viewer.set_property(["Background"], "visible", false);
    this.world = new THREE.Group();
    this.viewer.scene.add(this.world);
    this.room = room;
    this.dark = isDark();
    this.addLights();
    this.viewer.controls.dispose();
    this.viewer.set_camera(new THREE.PerspectiveCamera(FIELD, 1, 0.05, 500));
    this.frame(room.extent);
    this.viewer.set_3d_pane_size();
    this.viewer.controls.addEventListener("change", () => this.keepLabels());
  }

  addLights() {
    const THREE = this.THREE;
    this.viewer.renderer.outputEncoding = THREE.sRGBEncoding;
    const sky = new THREE.HemisphereLight(0xffffff, this.dark ? 0x555a66 : 0xa8afbb, 0.5);
    sky.position.set(0, 0, 1);
    this.sun = new THREE.DirectionalLight(0xffffff, 0.55);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.radius = 4;
    this.sun.shadow.bias = -0.0004;
    this.sun.shadow.normalBias = 0.01;
    this.world.add(sky, this.sun, this.sun.target);
  }

  /** Let the light and its shadow follow robots around (x, y), `wide` to either side. */
  light(x, y, wide) {
    const { height, low } = this.room, camera = this.sun.shadow.camera, z = low + height / 2;
    const reach = 1.5 * Math.max(this.room.reach, height) + wide;
    this.sun.target.position.set(x, y, z);
    this.sun.position.set(x + 1.2 * reach, y - 1.6 * reach, z + 3 * reach);
    if (camera.right !== reach) {
      Object.assign(camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1 * reach, far: 8 * reach });
      camera.updateProjectionMatrix();
    }
  }

  /** A shadow catcher, lines at round distances with numbers, and finer ones between. */
  addGround([x0, y0, x1, y1]) {
    const THREE = this.THREE, { reach, height, level } = this.room, margin = 1.5 * Math.max(reach, height);
    this.ground = new THREE.Group();
    this.labels = [];
    this.ground.position.z = level;
    this.world.add(this.ground);
    const step = roundStep(Math.max(x1 - x0, y1 - y0, margin) / 2);
    const [left, bottom] = [x0, y0].map((least) => step * Math.floor((least - margin) / step));
    const [right, top] = [x1, y1].map((most) => step * Math.ceil((most + margin) / step));
    const shade = new THREE.Mesh(
      new THREE.PlaneGeometry(3 * (right - left), 3 * (top - bottom)),
      new THREE.ShadowMaterial({ opacity: 0.22, depthWrite: false }));
    shade.position.set((left + right) / 2, (bottom + top) / 2, 0);
    shade.receiveShadow = true;
    this.ground.add(shade);
    this.addLines(left, bottom, right, top, step / 5, this.dark ? 0x2f3640 : 0xdde2e9);
    this.addLines(left, bottom, right, top, step, this.dark ? 0x4a5462 : 0xb4bdc9);
    const label = (value) => `${Number(value.toPrecision(6))} m`;
    for (const x of multiples(left, right, step)) this.addLabel(label(x), x, bottom - 0.16 * step);
    for (const y of multiples(bottom, top, step)) this.addLabel(label(y), left - 0.22 * step, y);
    this.addAxis([1, 0, 0], "#c0392b", "x", 0.5 * step);
    this.addAxis([0, 1, 0], "#2e8b57", "y", 0.5 * step);
  }

  addLines(left, bottom, right, top, step, color) {
    const material = new this.THREE.LineBasicMaterial({ color: flat(this.THREE, color) });
    const points = [];
    for (const x of multiples(left, right, step)) points.push(x, bottom, 0, x, top, 0);
    for (const y of multiples(bottom, top, step)) points.push(left, y, 0, right, y, 0);
    const geometry = new this.THREE.BufferGeometry();
    geometry.setAttribute("position", new this.THREE.Float32BufferAttribute(points, 3));
    this.ground.add(new this.THREE.LineSegments(geometry, material));
  }

  addAxis(direction, color, name, length) {
    const points = [0, 0, 0.001, direction[0] * length, direction[1] * length, 0.001];
    const width = 0.02 * length;
    const material = new this.THREE.MeshBasicMaterial({ color: flat(this.THREE, color) });
    this.ground.add(makeBand(this.THREE, points, [width, 0.0005], material));
    this.addLabel(name, direction[0] * length * 1.12, direction[1] * length * 1.12, color);
  }

  addLabel(text, x, y, color) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [160, 64];
    const pen = canvas.getContext("2d");
    Object.assign(pen, { font: "38px system-ui, sans-serif", textAlign: "center", textBaseline: "middle" });
    pen.fillStyle = color || (this.dark ? "#8d97a5" : "#6b7482");
    pen.fillText(text, 80, 34);
    const map = new this.THREE.CanvasTexture(canvas);
    map.encoding = this.THREE.sRGBEncoding;
    const label = new this.THREE.Sprite(new this.THREE.SpriteMaterial({ map, sizeAttenuation: false, depthWrite: false }));
    label.scale.set(0.075, 0.03, 1);
    label.position.set(x, y, 0);
    this.labels.push(label);
    this.ground.add(label);
  }

  /** Show a rectangle of the floor, from the front, the left and above. The camera's own y axis points up. */
  frame([x0, y0, x1, y1]) {
    if (this.ground) this.world.remove(this.ground);
    this.addGround([x0, y0, x1, y1]);
    const { height, low, margin } = this.room;
    const above = 0.68 * height; // the view's middle is below the robot's: the floor is to be seen, and no head is cut
    const radius = Math.hypot(Math.hypot(x1 - x0, y1 - y0) / 2 + margin, above);
    const narrow = Math.max(1, (1.1 * innerHeight) / innerWidth);
    const distance = (0.85 * narrow * radius) / Math.sin((FIELD / 2) * (Math.PI / 180));
    const centre = new this.THREE.Vector3((x0 + x1) / 2, (y0 + y1) / 2, low + height - above);
    this.lookAt(centre, new this.THREE.Vector3(0.64, -0.7, 0.44).normalize().multiplyScalar(distance).add(centre));
  }

  lookAt(target, from) {
    this.viewer.controls.target.set(target.x, target.z, -target.y);
    this.viewer.camera.position.set(from.x, from.z, -from.y);
    this.viewer.controls.update();
  }

  /** Move camera and target along with something that moved by (dx, dy). */
  follow(dx, dy) {
    for (const point of [this.viewer.controls.target, this.viewer.camera.position]) {
      point.x += dx;
      point.z -= dy;
    }
  }

  /** Labels that the edge of the view would cut, or that would cover one another, are left out. */
  keepLabels() {
    const { camera } = this.viewer, at = new this.THREE.Vector3(), [across, up] = [0, 5].map((i) => camera.projectionMatrix.elements[i]);
    const kept = [];
    camera.updateMatrixWorld();
    for (const label of this.labels) {
      label.getWorldPosition(at).project(camera);
      const { x, y } = at, [wide, high] = [across * label.scale.x, up * label.scale.y];
      const inside = at.z < 1 && Math.abs(x) + wide / 2 < 1 && Math.abs(y) + high / 2 < 1;
      const covers = (other) => Math.abs(x - other.x) < wide && Math.abs(y - other.y) < high;
      label.visible = inside && !kept.some(covers);
      if (label.visible) kept.push({ x, y });
    }
  }

  draw() {
    this.keepLabels();
    this.viewer.set_dirty();
  }
}
