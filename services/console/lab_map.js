// The lab seen from above, in SVG. Frame `map`: x east, y north, metres; one SVG unit is one metre.
// One component for the live view, for choosing a place, and for a recording that `lab_replay.js` replays.
// A camera zooms, moves and follows a robot. Each layer can be hidden.

const SVG = "http://www.w3.org/2000/svg";
const MARGIN_M = 0.35;
const MOST_ZOOM = 12;
const STEP = 1.5;
const DRAG_PX = 4;
const TRAIL = { points: 400, apart_m: 0.05 };
const LAYERS = { names: "Names", ways: "Ways that robots announce", trails: "Trails", items: "Items", grid: "Grid" };
const KEYS = {
  ArrowLeft: (map) => map.move(-1, 0),
  ArrowRight: (map) => map.move(1, 0),
  ArrowUp: (map) => map.move(0, -1),
  ArrowDown: (map) => map.move(0, 1),
  "+": (map) => map.zoom(STEP),
  "=": (map) => map.zoom(STEP),
  "-": (map) => map.zoom(1 / STEP),
  0: (map) => map.whole(),
};

function node(tag, attributes = {}, parent = null, text = null) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== null) element.textContent = text;
  if (parent) parent.appendChild(element);
  return element;
}

// A point of the map as "x,y" of the picture, whose y points down.
const at = ([x, y]) => `${x},${-y}`;
const placed = ({ x, y, yaw = 0 }) => `translate(${x}px, ${-y}px) rotate(${-yaw}rad)`;

export default {
  props: { lab: Object, pick: Boolean, label: String },
  emits: ["place"],
  template: `
    <div class="lab-map" :class="Object.keys(layers).filter((one) => !seen.includes(one)).map((one) => 'no-' + one)">
      <div class="lab-map-view" :class="{ zoomed }" tabindex="0" role="group" @keydown="onKey" @wheel="onWheel"
           aria-label="Map: arrow keys move it, plus and minus zoom, 0 shows the whole lab">
        <svg ref="svg" role="img" :aria-label="label" @click="onClick" @pointerdown="onDown" @pointermove="onMove"
             @pointerup="onUp" @pointercancel="onUp"></svg>
      </div>
      <div class="lab-tools">
        <label>Follow
          <select v-model="followed"><option value="">nothing</option><option v-for="name in known">{{ name }}</option></select>
        </label>
        <button type="button" @click="zoom(step)" aria-label="Zoom in">+</button>
        <button type="button" @click="zoom(1 / step)" aria-label="Zoom out">−</button>
        <button type="button" v-if="zoomed" @click="whole">Whole lab</button>
        <details><summary>Layers</summary>
          <label v-for="(words, name) in layers"><input type="checkbox" v-model="seen" :value="name" /> {{ words }}</label>
        </details>
      </div>
    </div>`,
  data: () => ({ followed: "", known: [], zoomed: false, layers: LAYERS, seen: Object.keys(LAYERS), step: STEP }),
  watch: {
    followed(name) {
      if (!name) return;
      if (!this.zoomed) this.at.zoom = 3;
      this.follow();
    },
  },
  mounted() {
    this.robots = {};
    this.items = {};
    this.drawLab();
    // A recording beside it is shown instead of what is live; nothing ends that.
    this.views = this.$el.closest(".lab-views");
    this.views?.addEventListener("lab-replayed", this.onReplay);
  },
  unmounted() {
    this.views?.removeEventListener("lab-replayed", this.onReplay);
  },
  methods: {
    drawLab() {
      const svg = this.$refs.svg;
      const [width, height] = this.lab.size_m;
      svg.replaceChildren();
      svg.setAttribute(
        "viewBox",
        `${-MARGIN_M} ${-height - MARGIN_M} ${width + 2 * MARGIN_M} ${height + 2 * MARGIN_M}`,
      );
      this.camera = node("g", { class: "camera moving" }, svg);
      this.whole();
      node("rect", { class: "floor", x: 0, y: -height, width, height }, this.camera);
      const grid = node("g", { class: "grid" }, this.camera);
      for (let x = 1; x < width; x++) node("line", { x1: x, x2: x, y1: 0, y2: -height }, grid);
      for (let y = 1; y < height; y++) node("line", { x1: 0, x2: width, y1: -y, y2: -y }, grid);
      for (const one of this.lab.furniture) {
        const group = node("g", { class: `furniture ${one.kind}` }, this.camera);
        const [w, h] = one.size_m;
        const box = node("rect", { x: -w / 2, y: -h / 2, width: w, height: h, rx: 0.04 }, group);
        box.style.transform = placed(one);
        if (one.kind === "wall") continue;
        const upright = w < 0.12 * one.name.length ? `rotate(-90 ${one.x} ${-one.y})` : "";
        node("text", { x: one.x, y: -one.y, transform: upright }, group, one.name);
      }
      for (const dock of this.lab.docks) this.drawDock(this.camera, dock);
      for (const bin of this.lab.bins) this.drawBin(this.camera, bin);
      for (const place of this.lab.places) this.drawPlace(this.camera, place);
      // Robots under items, which they carry, and every name on top.
      [this.found, this.lines, this.bodies, this.lying, this.names] = [0, 1, 2, 3, 4].map(() => node("g", {}, this.camera));
      this.marker = node("g", { class: "marker", visibility: "hidden" }, this.camera);
      node("circle", { r: 0.13 }, this.marker);
      node("path", { d: "M-0.24 0H0.24M0-0.24V0.24" }, this.marker);
    },

    drawDock(svg, dock) {
      const group = node("g", { class: "dock" }, svg);
      const box = node("rect", { x: -0.16, y: -0.3, width: 0.16, height: 0.6, rx: 0.03 }, group);
      box.style.transform = placed(dock);
      node("path", { d: "M0.02-0.13L-0.07 0.03H0L-0.02 0.13L0.07-0.03H0Z", class: "bolt",
        transform: `translate(${dock.x - 0.08 * Math.cos(dock.yaw)} ${-dock.y + 0.08 * Math.sin(dock.yaw)})` }, group);
      node("title", {}, group, `${dock.name}: charging dock`);
      // Before it, and beside the robot that stands on its contacts.
      this.drawName(group, dock, 0.3, 0.45);
    },

    drawPlace(svg, place) {
      const group = node("g", { class: "place" }, svg);
      node("circle", { cx: place.x, cy: -place.y, r: 0.07 }, group);
      node("text", { x: place.x, y: -place.y + 0.24 }, group, place.name);
    },

    drawBin(svg, bin) {
      const group = node("g", { class: "bin" }, svg);
      const [depth, width] = bin.size_m;
      const box = node("rect", { x: -depth / 2, y: -width / 2, width: depth, height: width, rx: 0.02 }, group);
      box.style.transform = placed(bin);
      for (const one of bin.compartments) {
        const [d, w] = one.size_m;
        const cell = node("rect", { class: `compartment ${one.name}`, x: -d / 2, y: -w / 2, width: d, height: w, rx: 0.02 }, group);
        cell.style.transform = placed({ ...one, yaw: bin.yaw });
        node("title", {}, cell, `${bin.name}: ${one.name} compartment`);
      }
      this.drawName(group, bin, depth / 2 + 0.18, 0);
    },

    // Ahead and to the left of where the thing faces, m.
    drawName(group, { name, x, y, yaw }, ahead, left) {
      const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
      node("text", { x: x + ahead * c - left * s, y: -(y + ahead * s + left * c) }, group, name);
    },

    robot(name) {
      if (this.robots[name]) return this.robots[name];
      const { bumper_m: front, half_width_m: half } = this.lab.robot;
      // As wide as the robot that goes there.
      const band = node("polyline", { class: "way band", "stroke-width": 2 * half }, this.lines);
      const way = node("polyline", { class: "way" }, this.lines);
      const trail = node("polyline", { class: "trail" }, this.lines);
      const group = node("g", { class: "robot" }, this.bodies);
      const turned = node("g", { class: "moving" }, group);
      for (const [x, y] of [[0.22, 0.35], [0.22, -0.35], [-0.22, 0.35], [-0.22, -0.35]])
        node("rect", { class: "wheel", x: x - 0.18, y: -y - 0.07, width: 0.36, height: 0.14, rx: 0.05 }, turned);
      node("rect", { class: "base", x: -front, y: -half + 0.12, width: 2 * front, height: 2 * half - 0.24, rx: 0.09 }, turned);
      node("path", { class: "heading", d: `M${front - 0.05} 0l-0.12-0.09v0.18z` }, turned);
      const arm = node("polyline", { class: "arm" }, turned);
      const tip = node("circle", { class: "tip", r: 0.055, visibility: "hidden" }, turned);
      const label = node("g", { class: "moving name" }, this.names);
      const title = node("text", { y: 0.68 }, label, name);
      this.known.push(name);
      return (this.robots[name] = { group, turned, arm, tip, label, title, way, band, trail, been: [] });
    },

    live(state) {
      if (!this.replays) this.show(state);
    },

    onReplay({ detail }) {
      this.replays = detail !== null;
      const nowhere = (drawn) => Object.fromEntries(Object.keys(drawn).map((name) => [name, {}]));
      if (!detail?.goesOn) for (const one of Object.values(this.robots)) one.been = [];
      if (!detail?.goesOn) this.show({ robots: nowhere(this.robots), items: nowhere(this.items) });
      if (detail) this.show(detail);
    },

    // robots: {name: {x, y, yaw, arm?, joints?, soc?, fresh, path?, trail?}}; items: {id: {x, y, z, quat?, fresh}}. What has
    // no place is hidden. `path` is the way ahead, `trail` where it has been; by default as seen since the page was opened.
    show(state) {
      // The 3-D view beside it shows the same, also if it comes later.
      this.$el.shown = state;
      this.$el.dispatchEvent(new CustomEvent("lab-shown", { detail: state, bubbles: true }));
      for (const [name, one] of Object.entries(state.robots)) {
        const drawn = this.robot(name);
        const visibility = one.x === undefined ? "hidden" : "visible";
        for (const part of [drawn.group, drawn.label, drawn.way, drawn.band, drawn.trail]) part.setAttribute("visibility", visibility);
        if (one.x === undefined) continue;
        // The shorter way round, or the robot would spin where its heading passes half a turn.
        const last = drawn.yaw ?? one.yaw;
        drawn.yaw = last + Math.atan2(Math.sin(one.yaw - last), Math.cos(one.yaw - last));
        drawn.turned.style.transform = placed({ ...one, yaw: drawn.yaw });
        drawn.label.style.transform = placed({ x: one.x, y: one.y });
        drawn.group.classList.toggle("stale", !one.fresh);
        drawn.title.textContent = one.fresh
          ? name + (one.soc === undefined ? "" : `  ${Math.round(one.soc * 100)} %`)
          : `${name}: last seen here`;
        drawn.arm.setAttribute("points", (one.arm ?? []).map(at).join(" "));
        drawn.tip.setAttribute("visibility", one.arm ? "inherit" : "hidden");
        if (one.arm) {
          const [x, y] = one.arm[one.arm.length - 1];
          drawn.tip.setAttribute("cx", x);
          drawn.tip.setAttribute("cy", -y);
        }
        for (const line of [drawn.way, drawn.band]) line.setAttribute("points", (one.path ?? []).map(at).join(" "));
        drawn.trail.setAttribute("points", (one.trail ?? this.been(drawn, one)).map(at).join(" "));
      }
      for (const [id, one] of Object.entries(state.items)) {
        let drawn = this.items[id];
        if (!drawn) {
          const kind = this.lab.items[id] ?? "trash";
          const group = node("g", { class: `item moving ${kind}` }, this.lying);
          node("circle", { r: 0.09 }, group);
          node("text", { y: 0.24 }, group, id);
          node("title", {}, group, `${id}: ${kind}`);
          drawn = this.items[id] = group;
        }
        drawn.setAttribute("visibility", one.x === undefined ? "hidden" : "visible");
        if (one.x === undefined) continue;
        drawn.style.transform = placed({ x: one.x, y: one.y });
        drawn.classList.toggle("stale", !one.fresh);
        // Labels of what lies in a bin would lie upon each other.
        const inside = this.lab.bins.some(
          (bin) => Math.hypot(one.x - bin.x, one.y - bin.y) < bin.size_m[1] / 2 + 0.1,
        );
        drawn.classList.toggle("inside", inside);
      }
      this.state = state;
      this.follow();
    },

    been({ been }, { x, y }) {
      const [lastX, lastY] = been.at(-1) ?? [Infinity, Infinity];
      if (Math.hypot(x - lastX, y - lastY) > TRAIL.apart_m) been.push([x, y]);
      if (been.length > TRAIL.points) been.shift();
      return been;
    },

    // -- camera: `at` is the middle of what is seen, in the picture's units, and how much larger than the whole lab

    look() {
      const [width, height] = this.lab.size_m;
      const { zoom } = this.at;
      const within = (value, low, size) => {
        const half = (size + 2 * MARGIN_M) / zoom / 2;
        return Math.min(Math.max(value, low - MARGIN_M + half), low + size + MARGIN_M - half);
      };
      this.at.x = within(this.at.x, 0, width);
      this.at.y = within(this.at.y, -height, height);
      this.zoomed = zoom > 1;
      this.camera.style.transform =
        `translate(${width / 2}px, ${-height / 2}px) scale(${zoom}) translate(${-this.at.x}px, ${-this.at.y}px)`;
      this.$refs.svg.style.setProperty("--zoom", zoom);
    },

    whole() {
      const [width, height] = this.lab.size_m;
      this.followed = "";
      this.at = { x: width / 2, y: -height / 2, zoom: 1 };
      this.look();
    },

    // `still` stays where it is.
    zoom(factor, still = this.at) {
      const zoom = Math.min(Math.max(this.at.zoom * factor, 1), MOST_ZOOM);
      const share = this.at.zoom / zoom;
      this.at = { x: still.x + (this.at.x - still.x) * share, y: still.y + (this.at.y - still.y) * share, zoom };
      this.look();
    },

    // By fifths of what is seen, to the right and down.
    move(right, down) {
      const [width, height] = this.lab.size_m;
      this.followed = "";
      this.at.x += (right * width) / this.at.zoom / 5;
      this.at.y += (down * height) / this.at.zoom / 5;
      this.look();
    },

    follow() {
      const one = this.followed && this.state?.robots[this.followed];
      if (one?.x === undefined) return;
      [this.at.x, this.at.y] = [one.x, -one.y];
      this.look();
    },

    onKey(event) {
      const act = KEYS[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      // Arrows scroll the page while the whole lab is seen.
      if (event.key.startsWith("Arrow") && !this.zoomed) return;
      event.preventDefault();
      act(this);
    },

    // Two fingers on a touchpad; the wheel alone scrolls the page.
    onWheel(event) {
      if (!event.ctrlKey) return;
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 100), this.under(event));
    },

    under({ clientX, clientY }) {
      return new DOMPoint(clientX, clientY).matrixTransform(this.camera.getScreenCTM().inverse());
    },

    onDown(event) {
      this.dragged = false;
      if (this.zoomed && event.button === 0) this.held = { id: event.pointerId, x: event.clientX, y: event.clientY };
    },

    onMove(event) {
      if (this.held?.id !== event.pointerId) return;
      const [dx, dy] = [event.clientX - this.held.x, event.clientY - this.held.y];
      if (!this.dragged && Math.hypot(dx, dy) < DRAG_PX) return;
      if (!this.dragged) event.currentTarget.setPointerCapture(event.pointerId);
      this.dragged = true;
      this.followed = "";
      const px = this.$refs.svg.getScreenCTM().a * this.at.zoom;
      this.at.x -= dx / px;
      this.at.y -= dy / px;
      [this.held.x, this.held.y] = [event.clientX, event.clientY];
      this.look();
    },

    onUp() {
      this.held = null;
    },

    // What robots have seen on the floor: [{id, x, y}].
    things(some) {
      this.found.replaceChildren();
      for (const { id, x, y } of some) {
        const group = node("g", { class: "item seen", transform: `translate(${x} ${-y})` }, this.found);
        node("path", { d: "M0-0.12L0.12 0L0 0.12L-0.12 0Z" }, group);
        node("text", { y: 0.27 }, group, `seen ${id}`);
        node("title", {}, group, `Thing ${id}, which a robot has seen`);
      }
    },

    // Where a task wants the robot to go; null takes the marker away.
    mark(place) {
      this.marker.setAttribute("visibility", place ? "visible" : "hidden");
      if (place) this.marker.setAttribute("transform", `translate(${place[0]} ${-place[1]})`);
    },

    onClick(event) {
      if (!this.pick || this.dragged) return;
      const point = this.under(event);
      const [width, height] = this.lab.size_m;
      const place = [Math.round(point.x * 100) / 100, Math.round(-point.y * 100) / 100];
      if (place[0] < 0 || place[1] < 0 || place[0] > width || place[1] > height) return;
      this.mark(place);
      this.$emit("place", place);
    },
  },
};
