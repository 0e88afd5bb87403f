// What somebody does to the object before them: every change is drawn, sent and can be undone.

import { turned } from "./draft.js";
import { ask, keyPath } from "./server.js";

const NEAR_M = 0.04; // snaps to what lies so near below

export class Editing {
  /** `app`: the page, whose `draft` is changed, if it `isOpen`; its `changed()` is called after. */
  constructor(app) {
    Object.assign(this, { app, snaps: false, dragging: null });
  }

  get draft() {
    return this.app.draft;
  }

  /** The key of a number: a candidate by its place in the tray. */
  digit(index) {
    const offer = this.draft?.offers[index];
    if (!offer) return;
    if (this.app.stepName === "rank") this.rank(offer.slot);
    else this.choose(offer.slot);
  }

  choose(slot) {
    if (this.app.isOpen) this.#edit(() => this.draft.choose(slot));
  }

  rank(slot, place = null) {
    if (this.app.isOpen) this.#edit(() => this.draft.rank(slot, place));
  }

  /** Move a ranked candidate along the ranking, and keep the focus on it. */
  moveRank(slot, by) {
    const place = this.draft.now.ranking.indexOf(slot) + (by > 0 ? 1 : -1);
    if (place < 0 || place >= this.draft.now.ranking.length) return;
    this.rank(slot, place);
    this.app.nodes.tray.querySelector(`[data-rank="${place}"]`)?.focus();
  }

  /** Put what is chosen somewhere. */
  place(transform) {
    if (this.app.isOpen && this.draft.chosen) this.#edit(() => this.draft.place(transform));
  }

  #edit(change) {
    this.dropped();
    const before = this.draft.version;
    change();
    if (this.draft.version !== before) this.app.changed();
  }

  undo() {
    this.dropped();
    if (this.app.isOpen && this.draft.undo()) this.app.changed();
  }

  redo() {
    this.dropped();
    if (this.app.isOpen && this.draft.redo()) this.app.changed();
  }

  /** Move what is chosen as one sees it [m]: to the right, away from the camera, up; along the axes of the room. */
  nudge(right, ahead, up) {
    const transform = this.draft?.transform;
    if (!transform || this.app.stepName === "rank") return;
    const { camera, controls } = this.app.stage.canvas;
    const [x, y] = [controls.target.x - camera.position.x, controls.target.y - camera.position.y];
    const [ax, ay] = Math.abs(x) > Math.abs(y) ? [Math.sign(x), 0] : [0, Math.sign(y) || 1];
    const [px, py, pz] = transform.position;
    this.place({ ...transform, position: [px + ax * ahead + ay * right, py + ay * ahead - ax * right, pz + up] });
  }

  turn(degrees) {
    if (this.draft?.transform) this.place(turned(this.draft.transform, degrees));
  }

  grow(factor) {
    const transform = this.draft?.transform;
    if (transform) this.place({ ...transform, scale: transform.scale.map((each) => each * factor) });
  }

  /** Put what is chosen down: on what lies below, or on the `floor`. */
  putDown(where) {
    const transform = this.draft?.transform;
    if (!transform) return;
    const [x, y] = transform.position;
    this.place({ ...transform, position: [x, y, where === "floor" ? 0 : this.app.stage.support(this.draft, transform)] });
  }

  /** Back to where selection put what is chosen. */
  reset() {
    if (this.draft?.chosen) this.place(this.draft.aligned(this.draft.chosen));
  }

  dragged(transform) {
    if (!this.app.isOpen) return;
    this.dragging = this.snaps && this.app.handle === "translate" ? this.#snapped(transform) : transform;
    this.app.stage.drag(this.dragging);
    this.app.fields.show(this.dragging, true, true);
  }

  #snapped(transform) {
    const [x, y, z] = transform.position;
    const below = this.app.stage.support(this.draft, transform);
    const isNear = !this.app.stage.gizmo.axis.includes("Z") || Math.abs(z - below) < NEAR_M;
    return isNear ? { ...transform, position: [x, y, below] } : transform;
  }

  /** The hand has let go: what was dragged is a change, and sent at once. */
  dropped() {
    const transform = this.dragging;
    this.dragging = null;
    if (!transform) return;
    this.place(transform);
    this.app.saving.flush();
  }

  /** Let the server put the object to rest where it stands. */
  async settle() {
    const { draft } = this;
    const { fields } = this.app;
    if (!this.app.isOpen || !draft.chosen || fields.settling.disabled) return;
    const { version } = draft;
    fields.isSettling = fields.settling.disabled = true;
    this.app.say("Settling …");
    try {
      const told = await ask("POST", `settle/${keyPath(draft.key)}`, draft.body);
      if (draft !== this.draft || draft.version !== version) {
        this.app.say("It was moved meanwhile: settle it again.");
        return;
      }
      const from = draft.transform;
      draft.place({ ...from, ...told.transform });
      this.app.figures = told.figures;
      this.app.changed();
      this.app.stage.slide(from, draft.transform);
      const how = told.steps.length ? ` (${told.steps.join(", ")})` : "";
      this.app.say(`Settled: moved by ${(told.moved_m * 100).toFixed(1)} cm${how}${told.problem ? `; ${told.problem}` : ""}`, Boolean(told.problem));
    } catch (error) {
      this.app.say(error.message, true);
    } finally {
      fields.isSettling = false;
      fields.settling.disabled = !this.app.isOpen || !this.draft?.chosen;
    }
  }
}
