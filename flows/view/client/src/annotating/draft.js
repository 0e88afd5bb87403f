// What somebody decides about one object: which candidate, where it stands, what comes next best. Every change can be undone.

import { Matrix4, Quaternion, Vector3 } from "three";

export const RANKED = 4; // the 2nd to the 5th
const UP = new Vector3(0, 0, 1);
const MOST_SECONDS = 86_400;
const LEAST_SCALE = 0.01;

/** Turn about +Z of a transform [degrees], in (-180, 180]. */
export function yawOf({ rotation_wxyz: [w, x, y, z] }) {
  return (Math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)) * 180) / Math.PI;
}

/** A transform turned further about +Z, in place. */
export function turned(transform, degrees) {
  const [w, x, y, z] = transform.rotation_wxyz;
  const turn = new Quaternion().setFromAxisAngle(UP, (degrees * Math.PI) / 180).multiply(new Quaternion(x, y, z, w)).normalize();
  return { ...transform, rotation_wxyz: [turn.w, turn.x, turn.y, turn.z] };
}

/** The pose of a transform, without its scale. */
export function poseOf({ position, rotation_wxyz: [w, x, y, z] }) {
  return new Matrix4().compose(new Vector3(...position), new Quaternion(x, y, z, w), new Vector3(1, 1, 1));
}

/** Scales above 0, however small somebody drew it. */
export const sound = (transform) => ({ ...transform, scale: transform.scale.map((factor) => Math.max(LEAST_SCALE, factor)) });

/** A transform between two. */
export function transformAt(from, to, share) {
  const turn = (numbers) => new Quaternion(numbers[1], numbers[2], numbers[3], numbers[0]);
  const at = turn(from.rotation_wxyz).slerp(turn(to.rotation_wxyz), share);
  const mixed = (name) => from[name].map((value, axis) => value + (to[name][axis] - value) * share);
  return { position: mixed("position"), rotation_wxyz: [at.w, at.x, at.y, at.z], scale: mixed("scale") };
}

export class Draft {
  /** `row`: an object as the server lists it. */
  constructor(row) {
    this.row = row;
    this.version = 0; // counts changes, so that one made while an earlier is on its way is not called saved
    this.kept = new Map(); // slot -> where it was put, for when it is chosen again
    const given = row.draft ?? row.answer;
    this.seconds = given?.seconds ?? 0;
    this.isLost = false; // whether what was chosen is no candidate any more: it must be chosen again
    this.lost = ""; // what is to be said of that
    this.states = [given ? this.#read(given) : this.#first()];
    this.at = 0;
  }

  get key() {
    return this.row.key;
  }

  get now() {
    return this.states[this.at];
  }

  /** The candidate that is chosen, or null. */
  get chosen() {
    return this.candidate(this.now.choice);
  }

  /** Where the chosen candidate stands. */
  get transform() {
    return this.chosen && (this.now.transform ?? this.aligned(this.chosen));
  }

  candidate(slot) {
    return this.row.candidates.find((offer) => offer.slot === slot) ?? null;
  }

  /** Candidates by selection's rank, those that it did not rank last. */
  get offers() {
    return [...this.row.candidates].sort((a, b) => (a.rank ?? 99) - (b.rank ?? 99) || a.slot - b.slot);
  }

  /** Where selection put a candidate; one that it put nowhere fills the scanned box. */
  aligned(offer) {
    if (offer.transform) return offer.transform;
    const { center, yaw_degrees: degrees, size } = this.row.box;
    const scale = offer.extents.map((length, axis) => (length > 1e-6 ? size[axis] / length : 1));
    return turned({ position: [center[0], center[1], center[2] - size[2] / 2], rotation_wxyz: [1, 0, 0, 0], scale: sound({ scale }).scale }, degrees);
  }

  /** Choose a candidate by slot; null: none fits. */
  choose(slot) {
    if (slot === this.now.choice && slot !== null) return;
    if (this.isLost) this.version += 1; // that none fits is a choice, too
    this.isLost = false;
    if (this.chosen) this.kept.set(this.now.choice, this.now.transform);
    const ranking = slot === null ? [] : this.now.ranking.filter((each) => each !== slot);
    this.#push({ choice: slot, transform: this.kept.get(slot) ?? null, ranking });
  }

  /** Put what is chosen somewhere else. */
  place(transform) {
    if (this.chosen) this.#push({ ...this.now, transform: sound(transform) });
  }

  /** Rank a candidate: at a place of the list (0: the 2nd best), else last. One that is ranked and gets no place is taken out. */
  rank(slot, place = null) {
    const { choice, ranking } = this.now;
    if (choice === null || slot === choice || !this.candidate(slot)) return;
    const rest = ranking.filter((each) => each !== slot);
    if (place === null && ranking.includes(slot)) {
      this.#push({ ...this.now, ranking: rest });
      return;
    }
    rest.splice(place ?? rest.length, 0, slot);
    this.#push({ ...this.now, ranking: rest.slice(0, RANKED) });
  }

  /** Back to an answer, as the server gives it; this can be undone, too. */
  back(answer) {
    this.#push(this.#read(answer));
    this.seconds = answer.seconds ?? 0;
  }

  undo() {
    return this.#step(-1);
  }

  redo() {
    return this.#step(1);
  }

  get canUndo() {
    return this.at > 0;
  }

  get canRedo() {
    return this.at < this.states.length - 1;
  }

  /** What the server is sent: assets and the transform as they are shown, whatever slots and selection mean later. */
  get body() {
    const { choice, ranking } = this.now;
    const assets = this.chosen ? [choice, ...ranking].map((slot) => this.candidate(slot).asset_id) : [];
    return {
      choice: assets[0] ?? null, transform: this.transform, ranking: [...new Set(assets)],
      seconds: Math.min(MOST_SECONDS, Math.round(this.seconds * 10) / 10),
    };
  }

  #step(by) {
    const at = this.at + by;
    if (at < 0 || at >= this.states.length) return false;
    this.at = at;
    this.version += 1;
    return true;
  }

  #push(state) {
    if (JSON.stringify(state) === JSON.stringify(this.now)) return;
    this.states.splice(this.at + 1, Infinity, state);
    this.at += 1;
    this.version += 1;
  }

  #first() {
    const best = this.offers[0] ?? null;
    return { choice: best?.slot ?? null, transform: null, ranking: [] };
  }

  /** A draft or an answer as the server gives it: candidates by slot or asset, turns as quaternion or yaw. */
  #read({ choice, transform, ranking }) {
    const slotOf = (name) => this.row.candidates.find((offer) => offer.slot === name || offer.asset_id === name)?.slot ?? null;
    const slot = choice === null || choice === undefined ? null : slotOf(choice);
    const slots = [...new Set((ranking ?? []).map(slotOf))].filter((each) => each !== null && each !== slot);
    this.isLost = slot === null && choice !== null && choice !== undefined;
    if (this.isLost) this.lost = "What was chosen is no candidate any more: choose again.";
    else if ((ranking ?? []).some((name) => slotOf(name) === null)) this.lost = "Some of what was ranked is no candidate any more: rank again.";
    let placed = slot === null ? null : (transform ?? null);
    if (placed && !placed.rotation_wxyz) {
      const { position, scale, yaw_degrees: degrees } = placed;
      placed = turned({ position, scale, rotation_wxyz: [1, 0, 0, 0] }, degrees);
    }
    return { choice: slot, transform: placed, ranking: slot === null ? [] : slots.slice(0, RANKED) };
  }
}
