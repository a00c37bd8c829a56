// The lab in three dimensions. It shows what the map beside it shows, live or of a recording: the map tells it
// with an event of the page, so that no message comes twice. It draws when something changed and somebody looks.

import { OrbitControls, THREE } from "nicegui-scene";

const WALL_M = 0.35;
const LEAST_MS = 50;

const geometries = {
  box: ([x, y, z]) => new THREE.BoxGeometry(2 * x, 2 * y, 2 * z),
  sphere: ([r]) => new THREE.SphereGeometry(r, 16, 12),
  ellipsoid: ([x, y, z]) => new THREE.SphereGeometry(1, 16, 12).scale(x, y, z),
  cylinder: ([r, half]) => new THREE.CylinderGeometry(r, r, 2 * half, 24).rotateX(Math.PI / 2),
  capsule: ([r, half]) => new THREE.CapsuleGeometry(r, 2 * half, 6, 14).rotateX(Math.PI / 2),
  mesh(_, { vertices, faces }) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(vertices, 3));
    geometry.setIndex(faces);
    geometry.computeVertexNormals();
    return geometry;
  },
};

function put(object, { pos, quat }) {
  const [w, x, y, z] = quat;
  object.position.set(...pos);
  object.quaternion.set(x, y, z, w);
}

function solid(shape) {
  const colour = new THREE.Color().setRGB(...shape.rgb, THREE.SRGBColorSpace);
  const mesh = new THREE.Mesh(geometries[shape.kind](shape.size, shape), new THREE.MeshLambertMaterial({ color: colour }));
  put(mesh, shape);
  return mesh;
}

function group(shapes, parent) {
  const made = new THREE.Group();
  for (const shape of shapes) made.add(solid(shape));
  parent.add(made);
  return made;
}

// A name that always faces the camera.
function label(text, parent, height) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [256, 64];
  const paint = canvas.getContext("2d");
  paint.font = "600 34px sans-serif";
  paint.textAlign = "center";
  paint.lineJoin = "round";
  paint.lineWidth = 10;
  paint.strokeStyle = "#fff";
  paint.fillStyle = "#15202b";
  paint.strokeText(text, 128, 44);
  paint.fillText(text, 128, 44);
  const map = new THREE.CanvasTexture(canvas);
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthTest: false, sizeAttenuation: false }));
  sprite.scale.set(0.24, 0.06, 1);
  sprite.position.z = height;
  parent.add(sprite);
}

// One body of a robot with what hangs on it; `set[joint](position)` moves it.
function body(part, parent, set) {
  const frame = new THREE.Group();
  put(frame, part);
  parent.add(frame);
  let inner = frame;
  for (const move of part.moves) {
    const moved = new THREE.Group();
    const [axis, anchor] = [move.axis, move.pos].map((values) => new THREE.Vector3(...values));
    set[move.joint] = (position) => {
      if (move.slides) return moved.position.copy(axis).multiplyScalar(position - move.zero);
      moved.quaternion.setFromAxisAngle(axis, position - move.zero);
      moved.position.copy(anchor).sub(anchor.clone().applyQuaternion(moved.quaternion));
    };
    inner.add(moved);
    inner = moved;
  }
  for (const shape of part.shapes) inner.add(solid(shape));
  for (const one of part.parts) body(one, inner, set);
  return frame;
}

export default {
  props: { label: String, source: String, ratio: Number },
  template: `
    <div class="lab-scene">
      <div class="lab-scene-view" v-show="!problem" ref="view" role="img" :aria-label="label"
           :style="{ aspectRatio: ratio }"></div>
      <p v-if="problem" class="empty">{{ problem }}</p>
      <div v-else class="lab-tools">
        <label>Look at
          <select v-model="target"><option value="">the lab</option><option v-for="name in places">{{ name }}</option></select>
        </label>
        <button type="button" @click="nearer(0.75)" aria-label="Nearer">+</button>
        <button type="button" @click="nearer(1.33)" aria-label="Farther">−</button>
      </div>
    </div>`,
  data: () => ({ problem: "", target: "", places: [] }),
  watch: {
    target() {
      this.look();
    },
  },

  async mounted() {
    // Asked before three.js does, which would complain on the console of the browser.
    if (!document.createElement("canvas").getContext("webgl2")) {
      this.problem = "This browser draws no 3-D view. The map shows the same.";
      return;
    }
    let lab;
    try {
      const answer = await fetch(this.source);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      lab = await answer.json();
    } catch (error) {
      this.problem = `The 3-D view cannot be loaded (${error.message}). The map shows the same.`;
      return;
    }
    if (!this.$refs.view) return; // left meanwhile
    this.build(lab);
  },

  unmounted() {
    for (const end of this.ends ?? []) end();
  },

  methods: {
    build(lab) {
      const view = this.$refs.view;
      this.lab = lab;
      this.scene = new THREE.Scene();
      this.camera = new THREE.PerspectiveCamera(45, 1.6, 0.05, 100);
      this.camera.up.set(0, 0, 1);
      this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
      this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      view.append(this.renderer.domElement);
      this.controls = new OrbitControls(this.camera, this.renderer.domElement);
      // The wheel and a finger's vertical way scroll the page.
      this.controls.enableZoom = false;
      this.controls.maxPolarAngle = 1.5;
      this.renderer.domElement.style.touchAction = "pan-y";
      this.controls.addEventListener("change", () => this.draw());
      this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a94a0, 2.2));
      const sun = new THREE.DirectionalLight(0xffffff, 1.6);
      sun.position.set(-3, -4, 8);
      this.scene.add(sun);
      this.buildRoom(lab);
      this.items = Object.fromEntries(Object.entries(lab.items).map(([id, shapes]) => [id, group(shapes, this.scene)]));
      this.robots = Object.fromEntries(Object.entries(lab.robots).map(([name, drawing]) => {
        const [root, set] = [new THREE.Group(), []];
        this.scene.add(root);
        body(drawing, root, set);
        label(name, root, 1.15);
        const path = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0x0f8d7a }));
        path.frustumCulled = false;
        this.scene.add(path);
        return [name, { root, set, path }];
      }));
      this.places = [...Object.keys(lab.robots), ...Object.keys(lab.bins)];
      for (const one of [...Object.values(this.items), ...Object.values(this.robots).map(({ root }) => root)]) one.visible = false;
      this.watch(view);
      this.look();
    },

    buildRoom({ size_m: [width, height], fixed, bins }) {
      this.floor = new THREE.Mesh(new THREE.PlaneGeometry(width, height), new THREE.MeshLambertMaterial());
      this.floor.position.set(width / 2, height / 2, 0);
      this.scene.add(this.floor);
      const points = [];
      for (let x = 1; x < width; x++) points.push(x, 0, 0.002, x, height, 0.002);
      for (let y = 1; y < height; y++) points.push(0, y, 0.002, width, y, 0.002);
      const grid = new THREE.BufferGeometry();
      grid.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
      this.lines = new THREE.LineSegments(grid, new THREE.LineBasicMaterial());
      this.scene.add(this.lines);
      this.walls = new THREE.MeshLambertMaterial();
      const wall = (x, y, w, h) => {
        const mesh = new THREE.Mesh(new THREE.BoxGeometry(w, h, WALL_M), this.walls);
        mesh.position.set(x, y, WALL_M / 2);
        this.scene.add(mesh);
      };
      for (const y of [-0.03, height + 0.03]) wall(width / 2, y, width + 0.12, 0.06);
      for (const x of [-0.03, width + 0.03]) wall(x, height / 2, 0.06, height);
      group(fixed, this.scene);
      for (const [name, { x, y }] of Object.entries(bins)) {
        const place = new THREE.Group();
        place.position.set(x, y, 0);
        this.scene.add(place);
        label(name, place, 0.75);
      }
    },

    watch(view) {
      const shown = ({ detail }) => this.show(detail);
      const views = this.$el.closest(".lab-views") ?? document;
      views.addEventListener("lab-shown", shown);
      const size = new ResizeObserver(() => {
        const { clientWidth: w, clientHeight: h } = view;
        if (!w || !h) return;
        this.renderer.setSize(w, h);
        this.camera.aspect = w / h;
        this.camera.updateProjectionMatrix();
        this.draw();
      });
      size.observe(view);
      const sight = new IntersectionObserver((entries) => {
        this.inSight = entries.some((one) => one.isIntersecting);
        this.draw();
      });
      sight.observe(view);
      const draw = () => this.draw();
      document.addEventListener("visibilitychange", draw);
      const theme = new MutationObserver(draw);
      theme.observe(document.body, { attributes: true, attributeFilter: ["class"] });
      this.ends = [
        () => views.removeEventListener("lab-shown", shown),
        () => document.removeEventListener("visibilitychange", draw),
        () => [size, sight, theme].forEach((one) => one.disconnect()),
        () => clearTimeout(this.due),
        () => this.controls.dispose(),
        () => this.renderer.dispose(),
      ];
      // What the map showed before this was here.
      const state = views.querySelector(".lab-map")?.shown;
      if (state) this.show(state);
    },

    // As the map's `show`.
    show({ robots, items }) {
      this.state = robots;
      for (const [name, { root, set, path }] of Object.entries(this.robots)) {
        const one = robots[name];
        root.visible = path.visible = one?.x !== undefined;
        if (!root.visible) continue;
        root.position.set(one.x, one.y, 0);
        root.rotation.z = one.yaw;
        (one.joints ?? []).forEach((position, joint) => position === null || set[joint]?.(position));
        path.geometry.setFromPoints((one.path ?? one.trail ?? []).map(([x, y]) => new THREE.Vector3(x, y, 0.01)));
      }
      for (const [id, group] of Object.entries(this.items)) {
        const one = items[id];
        group.visible = one?.x !== undefined;
        if (group.visible) put(group, { pos: [one.x, one.y, one.z], quat: one.quat ?? [1, 0, 0, 0] });
      }
      this.follow();
      this.draw();
    },

    // Where the chosen thing is.
    place() {
      const one = this.state?.[this.target] ?? this.lab.bins[this.target];
      return one?.x === undefined ? null : new THREE.Vector3(one.x, one.y, 0.4);
    },

    look() {
      if (!this.lab) return;
      const [width, height] = this.lab.size_m;
      const place = this.place();
      const size = 1.1 * Math.max(width, 1.4 * height);
      this.controls.target.copy(place ?? new THREE.Vector3(width / 2, 0.47 * height, 0));
      const away = place ? [-1.3, -1.9, 1.3] : [-0.06 * size, -0.66 * size, 0.62 * size];
      this.camera.position.copy(this.controls.target).add(new THREE.Vector3(...away));
      this.controls.update();
      this.draw();
    },

    follow() {
      const place = this.target && this.place();
      if (!place) return;
      this.camera.position.add(place.clone().sub(this.controls.target));
      this.controls.target.copy(place);
      this.controls.update();
    },

    nearer(factor) {
      const { target } = this.controls;
      this.camera.position.sub(target).multiplyScalar(factor).add(target);
      this.controls.update();
      this.draw();
    },

    draw() {
      if (this.due || !this.inSight || document.hidden) return;
      this.due = setTimeout(() => requestAnimationFrame(() => {
        this.due = 0;
        const style = getComputedStyle(this.$el);
        const colour = (name) => new THREE.Color(style.getPropertyValue(name).trim());
        this.floor.material.color = colour("--floor");
        this.lines.material.color = colour("--line");
        this.walls.color = colour("--line");
        this.renderer.render(this.scene, this.camera);
        this.$el.dataset.drawn = Number(this.$el.dataset.drawn ?? 0) + 1;
      }), LEAST_MS);
    },
  },
};
