// The site's clock. The server says how late it is and how fast it goes when that changes; in between, it continues
// by itself.

const STANDS = 1e-3;
const REAL = 0.05;

export default {
  template: `<span class="clock" role="timer" aria-label="Site time" :title="title">{{ text }}</span>`,
  props: { zone: String },
  data: () => ({ said: null, heard_ms: 0, text: "", title: "" }),
  mounted() { this.tick = setInterval(this.draw, 1000); this.draw(); },
  unmounted() { clearInterval(this.tick); },
  methods: {
    show(said) {
      this.said = said;
      this.heard_ms = performance.now();
      this.draw();
    },
    draw() {
      if (this.said === null) {
        this.text = "no clock";
        this.title = "How late it is is not known: robot_sim is silent";
        return;
      }
      const [at_s, speed] = this.said;
      const now = new Date(1e3 * at_s + speed * (performance.now() - this.heard_ms)).toISOString();
      const real = Math.abs(speed - 1) < REAL;
      const pace = speed <= STANDS ? "stopped" : real ? "" : ` ${Number(speed.toPrecision(2))}×`;
      this.text = `${now.slice(11, 19)} ${this.zone} ${pace}`.trim();
      const fast = speed <= STANDS ? "stands" : real ? "goes as fast as the wall's" : `goes ${pace.trim()} as fast as the wall's`;
      this.title = `${now.slice(0, 10)} ${now.slice(11, 19)} ${this.zone}; the site's clock ${fast}`;
    },
  },
};
