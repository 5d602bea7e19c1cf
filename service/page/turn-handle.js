// A handle at the rear of the projectile in the side view, which turns it about the point of contact.

import { element } from "./elements.js";
import { contactOf } from "./side-view.js";

const RADIAN = Math.PI / 180;
const [LEAST_DEG, MOST_DEG] = [0, 89.9]; // range of the slider in the form
const STEPS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 5, PageDown: -5, Home: -Infinity, End: Infinity };

/** A slider that is moved by dragging or by keys. */
export class TurnHandle {
  isHeld = false;
  #run;
  #angle; // between velocity and normal, as last turned or drawn [°]

  /**
   * @param {HTMLElement} root element of the side view
   * @param {{onTurn: (angle: number) => void, onHold: (isHeld: boolean) => void}} listeners `onHold` is called when the handle
   *   is grabbed and when it is released
   */
  constructor(root, { onTurn, onHold }) {
    Object.assign(this, { plotRoot: root, onTurn });
    const hold = (isHeld) => {
      if (this.isHeld === isHeld) return;
      this.isHeld = isHeld;
      onHold(isHeld);
    };
    this.root = element("div.handle", {
      role: "slider",
      tabindex: 0,
      "aria-label": "Oblique angle, in the side view",
      "aria-valuemin": LEAST_DEG,
      "aria-valuemax": MOST_DEG,
      onpointerdown: (event) => {
        hold(true);
        this.root.setPointerCapture(event.pointerId);
      },
      onpointermove: (event) => this.isHeld && this.#turn(this.#angleAt(event)),
      onpointerup: () => hold(false),
      onpointercancel: () => hold(false),
      onkeydown: (event) => {
        if (!(event.key in STEPS)) return;
        event.preventDefault();
        this.#turn(this.#angle + STEPS[event.key] * (event.shiftKey ? 0.1 : 1));
      },
    });
  }

  /** Adapt the handle to the run that is drawn; `words` describe its outcome. */
  follow(run, words) {
    this.#run = run;
    if (!this.isHeld) this.#angle = run.values.impact.oblique_angle_deg;
    this.root.setAttribute("aria-valuetext", `${run.values.impact.oblique_angle_deg}° from the normal: ${words}`);
    if (!this.root.isConnected) this.plotRoot.append(this.root); // after the drawing, which comes first
    this.place();
  }

  #turn(angle) {
    const next = Number(Math.min(Math.max(angle, LEAST_DEG), MOST_DEG).toFixed(1));
    if (next === this.#angle) return;
    this.#angle = next;
    this.place();
    this.onTurn(next);
  }

  /** Put the handle at the rear of the projectile. */
  place() {
    if (!this.#run) return;
    const [origin, scale] = contactOf(this.plotRoot);
    const reach = this.#run.projectile.length_m * scale;
    const angle = (this.#angle + this.#attack()) * RADIAN;
    this.root.setAttribute("aria-valuenow", this.#angle);
    this.root.style.left = `${origin[0] - reach * Math.sin(angle)}px`;
    this.root.style.top = `${origin[1] - reach * Math.cos(angle)}px`;
  }

  #angleAt({ clientX, clientY }) {
    const box = this.plotRoot.querySelector(".drawing").getBoundingClientRect();
    const [[x, y]] = contactOf(this.plotRoot);
    return Math.atan2(box.left + x - clientX, box.top + y - clientY) / RADIAN - this.#attack();
  }

  #attack() {
    return this.#run.values.impact.angle_of_attack_deg ?? 0;
  }
}
