// A recording with a slider of its time. It tells the views beside it what to show, with an event of the page.

const NEAR = 0.03;

const clock = (seconds) => {
  const whole = Math.max(0, Math.round(seconds));
  const minutes = String(Math.floor(whole / 60) % 60).padStart(2, "0");
  const hours = Math.floor(whole / 3600);
  return `${hours ? hours + ":" : ""}${minutes}:${String(whole % 60).padStart(2, "0")}`;
};

export default {
  template: `
    <div class="lab-replay">
      <div v-if="track" class="lab-map-player">
        <button type="button" class="lab-map-play" @click="toggle" :aria-label="playing ? 'Pause' : 'Play'">
          {{ playing ? "❚❚" : "▶" }}
        </button>
        <input type="range" min="0" :max="track.duration_s" step="0.1" v-model.number="now_s"
               aria-label="Time in the recording" :aria-valuetext="spoken" @input="stop" />
        <output>{{ spoken }}</output>
        <label class="lab-map-speed">Speed
          <select v-model.number="speed"><option :value="1">1×</option><option :value="10">10×</option><option :value="30">30×</option></select>
        </label>
      </div>
      <div v-if="checks.length" class="lab-checks" role="group" aria-label="Checks at their seconds">
        <button v-for="one in checks" type="button" :class="{ bad: one.failed }" :style="{ left: share(one.t), bottom: 2 + 16 * one.row + 'px' }"
                :title="one.moment + ': ' + one.checks.join('; ')" :aria-label="spokenCheck(one)" @click="jump(one.t)"></button>
        <span class="cursor" :style="{ left: share(now_s) }"></span>
      </div>
      <p v-if="last" class="soft"><strong>{{ last.moment }}</strong>: {{ last.checks.join("; ") }}</p>
      <button v-if="failed" type="button" class="lab-failed" @click="jump(failed.t)">Go to what failed: {{ failed.moment }}, {{ time(failed.t) }}</button>
      <div v-if="track && track.curves.length" class="lab-curves">
        <figure v-for="one in curves">
          <figcaption>{{ one.name }} <strong>{{ one.now }} {{ one.unit }}</strong><span v-if="one.limit !== null">, limit {{ one.limit }}</span></figcaption>
          <svg viewBox="0 0 100 100" preserveAspectRatio="none" role="img" :aria-label="one.name + ' over time'" @click="seek">
            <line v-if="one.bound !== null" class="limit" x1="0" x2="100" :y1="one.bound" :y2="one.bound" />
            <polyline :points="one.points" />
            <line class="cursor" :x1="cursor" :x2="cursor" y1="0" y2="100" />
          </svg>
        </figure>
      </div>
      <div v-if="pictures.length" class="lab-pictures">
        <figure v-for="one in pictures">
          <img :src="one.src" :alt="'What ' + one.from + ' saw'" />
          <figcaption>{{ one.from }}, {{ time(one.t) }}</figcaption>
        </figure>
      </div>
      <ol v-if="track && track.marks.length" class="lab-map-marks" aria-label="What was recorded">
        <li v-for="mark in track.marks" :class="{ past: mark.t <= now_s }">
          <button type="button" @click="jump(mark.t)"><time>{{ time(mark.t) }}</time> {{ mark.text }}</button>
        </li>
      </ol>
    </div>`,
  data: () => ({ track: null, now_s: 0, playing: false, speed: 10 }),
  computed: {
    spoken() {
      return `${clock(this.now_s)} of ${clock(this.track.duration_s)}`;
    },
    // A dot that would cover the one before stands above it.
    checks() {
      let [before, row] = [-Infinity, 0];
      return (this.track?.checks ?? []).map((one) => {
        row = one.t - before < NEAR * this.track.duration_s ? (row + 1) % 3 : 0;
        before = one.t;
        return { ...one, row };
      });
    },
    failed() {
      return this.checks.find((one) => one.failed);
    },
    // The moment that the cursor is at, or came by last.
    last() {
      return this.checks.findLast((one) => one.t <= this.now_s + 0.05);
    },
    cursor() {
      return (100 * this.now_s) / this.track.duration_s;
    },
    // Lines do not move with the cursor: they are computed once for each recording.
    lines() {
      const { t, duration_s, curves } = this.track;
      return curves.map(({ name, unit, values, limit }) => {
        const most = Math.max(...values, limit ?? -Infinity, 1e-6) * 1.05;
        const least = Math.min(0, ...values);
        const y = (value) => 100 - (100 * (value - least)) / (most - least);
        const points = values.map((value, i) => `${((100 * t[i]) / duration_s).toFixed(2)},${y(value).toFixed(1)}`).join(" ");
        return { name, unit, limit, values, points, bound: limit === null ? null : y(limit) };
      });
    },
    curves() {
      const row = this.row();
      return this.lines.map((one) => ({ ...one, now: one.values[row].toFixed(2) }));
    },
    // The newest of each camera.
    pictures() {
      const taken = (this.track?.pictures ?? []).filter((one) => one.t <= this.now_s);
      return Object.values(Object.fromEntries(taken.map((one) => [one.from, one])));
    },
  },
  watch: {
    now_s() {
      this.show(true);
    },
  },
  unmounted() {
    this.stop();
  },
  methods: {
    time: clock,

    // track: {duration_s, t: [..], robots: {name: {x, y, yaw, arm, joints, soc}}, items: {id: {x, y, z, quat}},
    // marks: [{t, text}], pictures: [{t, from, src}], curves: [{name, unit, values, limit}],
    // checks: [{t, moment, failed, checks: [words]}]}. Null ends the replay.
    replay(track) {
      this.stop();
      // Not watched: it is large, and never changes.
      this.track = track && Object.freeze(track);
      this.now_s = 0;
      this.show(false);
    },

    tell(detail) {
      this.$el.dispatchEvent(new CustomEvent("lab-replayed", { detail, bubbles: true }));
    },

    share(seconds) {
      return `${(100 * seconds) / this.track.duration_s}%`;
    },

    spokenCheck({ moment, t, checks }) {
      return `${clock(t)} ${moment}: ${checks.join("; ")}`;
    },

    seek(event) {
      const { left, width } = event.currentTarget.getBoundingClientRect();
      this.jump(((event.clientX - left) / width) * this.track.duration_s);
    },

    // The last instant up to the cursor.
    row() {
      const { t } = this.track;
      let low = 0;
      let high = t.length - 1;
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (t[middle] <= this.now_s) low = middle;
        else high = middle - 1;
      }
      return low;
    },

    show(goesOn) {
      if (!this.track) return this.tell(null);
      const { robots, items } = this.track;
      const low = this.row();
      const pick = (columns) =>
        Object.fromEntries(Object.entries(columns).map(([key, values]) => [key, values[low] ?? undefined]));
      const state = { goesOn, robots: {}, items: {} };
      for (const [name, one] of Object.entries(robots))
        state.robots[name] = { ...pick(one), fresh: true, trail: one.x.slice(0, low + 1).map((x, i) => [x, one.y[i]]) };
      for (const [id, one] of Object.entries(items)) state.items[id] = { ...pick(one), fresh: true };
      this.tell(state);
    },

    jump(seconds) {
      this.stop();
      this.now_s = seconds;
    },

    stop() {
      this.playing = false;
      cancelAnimationFrame(this.frame);
    },

    toggle() {
      if (this.playing) return this.stop();
      if (this.now_s >= this.track.duration_s) this.now_s = 0;
      this.playing = true;
      let before = performance.now();
      const step = (now) => {
        this.now_s = Math.min(this.now_s + ((now - before) / 1000) * this.speed, this.track.duration_s);
        before = now;
        if (this.now_s >= this.track.duration_s) this.stop();
        else this.frame = requestAnimationFrame(step);
      };
      this.frame = requestAnimationFrame(step);
    },
  },
};
