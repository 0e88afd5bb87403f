// Where the chosen candidate stands, as numbers.

import { make } from "../dom.js";
import { turned, yawOf } from "./draft.js";

const FIELDS = [
  ["x", "X", "m", 0.01], ["y", "Y", "m", 0.01], ["z", "Z", "m", 0.01],
  ["yaw", "Turn", "°", 1], ["height", "Over support", "m", 0.01], ["all", "Scale", "×", 0.01],
  ["sx", "Scale x", "×", 0.01], ["sy", "Scale y", "×", 0.01], ["sz", "Scale z", "×", 0.01],
];
const DIGITS = { m: 3, "°": 1, "×": 3 };
const LEAST_SCALE = 0.01;

export class Fields {
  /** `on`: `change(transform)`, `support(transform)`, `snap(isOn)`, `putDown(where)`, `settle()`, `reset()`. */
  constructor(on) {
    this.on = on;
    this.transform = null;
    this.isSettling = false; // while the server puts something to rest, it is asked for nothing else
    this.inputs = Object.fromEntries(FIELDS.map(([name, text, unit, step]) => [name, make("input", {
      type: "number", step: String(step), "aria-label": `${text} [${unit}]`, "data-field": name, onchange: () => this.#changed(name),
    })]));
    for (const [name, input] of Object.entries(this.inputs)) {
      input.addEventListener("keydown", (event) => event.key === "Enter" && !event.ctrlKey && input.blur()); // which takes it over
    }
    this.snap = make("input", { type: "checkbox", onchange: () => on.snap(this.snap.checked) });
    const rows = FIELDS.map(([name, text, unit]) => make("label", { class: "field" }, make("span", { textContent: text }), this.inputs[name], make("small", { textContent: unit })));
    const act = (text, title, run) => make("button", { type: "button", class: "toggle", textContent: text, title, onclick: run });
    this.settling = act("Settle this", "L", () => on.settle());
    this.buttons = [
      act("Onto support", "B", () => on.putDown("support")), act("Onto floor", "G", () => on.putDown("floor")), this.settling,
      act("As selection put it", "", () => on.reset()),
    ];
    this.node = make("section", { class: "fields" }, make("h3", { textContent: "Alignment" }), make("div", { class: "grid" }, ...rows),
      make("label", { class: "check" }, this.snap, make("span", { textContent: "snap to what is below while moving" })), make("div", { class: "acts" }, ...this.buttons));
  }

  /** Show a transform; null: there is nothing to align. `isQuick`: while it moves, when what lies below is not looked for. */
  show(transform, isOpen = true, isQuick = false) {
    this.transform = transform;
    this.node.querySelectorAll("input, button").forEach((node) => {
      node.disabled = !transform || !isOpen || (node === this.settling && this.isSettling);
    });
    if (!transform) {
      for (const input of Object.values(this.inputs)) input.value = "";
      return;
    }
    if (!isQuick) this.support = this.on.support(transform);
    const [x, y, z] = transform.position;
    const [sx, sy, sz] = transform.scale;
    const values = { x, y, z, yaw: yawOf(transform), height: z - this.support, all: Math.cbrt(sx * sy * sz), sx, sy, sz };
    for (const [name, , unit] of FIELDS) this.inputs[name].value = String(Number(values[name].toFixed(DIGITS[unit])));
  }

  #changed(name) {
    const { transform } = this;
    const value = this.inputs[name].valueAsNumber;
    if (!transform) return;
    if (!Number.isFinite(value)) {
      this.show(transform);
      return;
    }
    const changed = this.#with(transform, name, value);
    if (JSON.stringify(changed) !== JSON.stringify(transform)) this.on.change(changed);
  }

  #with(transform, name, value) {
    const [position, scale] = [[...transform.position], [...transform.scale]];
    if (name === "yaw") return turned(transform, value - yawOf(transform));
    if (name === "all") {
      const factor = Math.max(LEAST_SCALE, value) / Math.cbrt(scale[0] * scale[1] * scale[2]);
      return { ...transform, scale: scale.map((each) => each * factor) };
    }
    if (name === "height") position[2] = this.support + value;
    else if (name.startsWith("s")) scale["xyz".indexOf(name[1])] = Math.max(LEAST_SCALE, value);
    else position["xyz".indexOf(name)] = value;
    return { ...transform, position, scale };
  }
}
