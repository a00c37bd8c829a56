// A part of a page whose content is replaced when what it shows has changed. Who had the keyboard's focus in it
// keeps it, on the control that comes back in the same place under the same name.

const CONTROLS = "a[href], button, input, select, textarea, [tabindex]";

const named = (control) => `${control.tagName} ${control.getAttribute("aria-label") ?? control.textContent.trim()}`;

export default {
  template: `<div><slot></slot></div>`,
  beforeUpdate() {
    const control = document.activeElement;
    this.lost = this.$el.contains(control) ? { control, alike: this.alike(control) } : null;
  },
  mounted() {
    this.sizes = new ResizeObserver(() => this.reach());
    this.sizes.observe(this.$el);
  },
  unmounted() {
    this.sizes.disconnect();
  },
  updated() {
    this.reach();
    if (!this.lost || this.lost.control.isConnected) return;
    const { control, alike } = this.lost;
    const found = this.alike(control);
    (found[alike.indexOf(control)] ?? found.at(-1))?.focus({ preventScroll: true });
  },
  methods: {
    // What is wider than its card is scrolled with the keyboard, too: it takes the focus then, and only then.
    reach() {
      for (const one of this.$el.querySelectorAll(".table-scroll"))
        if (one.scrollWidth > one.clientWidth) one.tabIndex = 0;
        else one.removeAttribute("tabindex");
    },
    // Several rows may have a button of one name.
    alike(control) {
      return [...this.$el.querySelectorAll(CONTROLS)].filter((one) => named(one) === named(control));
    },
  },
};
