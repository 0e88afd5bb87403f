// Handles in the scene that move, turn and scale what is chosen.

import { Object3D } from "three";
import { TransformControls } from "three/addons/controls/TransformControls.js";

export class Gizmo {
  /** `moved` is told every transform while something is dragged; `done` once the hand lets go. */
  constructor(canvas, moved, done) {
    this.held = new Object3D(); // stands where the object stands
    this.controls = new TransformControls(canvas.camera, canvas.node);
    this.controls.setSize(0.85);
    canvas.marks.add(this.held, this.controls.getHelper());
    this.controls.addEventListener("change", () => canvas.draw());
    this.controls.addEventListener("dragging-changed", ({ value }) => {
      canvas.controls.enabled = !value;
    });
    this.controls.addEventListener("objectChange", () => moved(this.#read()));
    this.controls.addEventListener("mouseUp", () => done());
    this.mode("translate");
    this.at(null);
  }

  /** `translate`, `rotate` about the vertical, or `scale` along the asset's own axes. */
  mode(name) {
    this.controls.setMode(name);
    this.controls.setSpace(name === "scale" ? "local" : "world");
    this.controls.showX = this.controls.showY = name !== "rotate";
  }

  /** Where the handles are; null: nowhere. While something is dragged they stay in the hand. */
  at(transform) {
    if (transform === null) {
      this.controls.detach();
      return;
    }
    if (!this.controls.dragging) {
      const [w, x, y, z] = transform.rotation_wxyz;
      this.held.position.set(...transform.position);
      this.held.quaternion.set(x, y, z, w);
      this.held.scale.set(...transform.scale);
    }
    this.held.updateMatrixWorld();
    if (this.controls.object !== this.held) this.controls.attach(this.held);
  }

  /** Whether the pointer is on a handle: a click there selects nothing. */
  get isTaken() {
    return this.controls.dragging || this.controls.axis !== null;
  }

  /** Names of the axes that are dragged, such as "XY". */
  get axis() {
    return this.controls.axis ?? "";
  }

  #read() {
    const { position, quaternion, scale } = this.held;
    return { position: position.toArray(), rotation_wxyz: [quaternion.w, quaternion.x, quaternion.y, quaternion.z], scale: scale.toArray() };
  }
}
