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
  updated() {
    if (!this.lost || this.lost.control.isConnected) return;
    const { control, alike } = this.lost;
    const found = this.alike(control);
    (found[alike.indexOf(control)] ?? found.at(-1))?.focus({ preventScroll: true });
  },
  methods: {
    // Several rows may have a button of one name.
    alike(control) {
      return [...this.$el.querySelectorAll(CONTROLS)].filter((one) => named(one) === named(control));
    },
  },
};
