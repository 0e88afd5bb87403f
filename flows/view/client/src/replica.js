// The objects of a replica: each an asset, scaled and posed; another candidate can be tried in its place.

import { Box3, Color, Group, Matrix4 } from "three";
import { between, boxOf, meshes, model, pose, release } from "./models.js";

/** Where an object stands at a time: 0 proposed, 1 optimized, 2 settled. */
export function poseAt(poses, time) {
  const stops = [poses.proposed, poses.optimized, poses.settled ?? poses.optimized].map(pose);
  const first = Math.min(1, Math.floor(time));
  return between(stops[first], stops[first + 1], Math.min(1, time - first));
}

export class Replica {
  constructor(document_, group) {
    this.document = document_;
    this.group = group;
    this.rows = new Map(document_.objects.map((row) => [row.id, row]));
    this.shown = new Map(); // id -> group at its pose
    this.tried = new Map(); // id -> slot of the candidate that is tried
    this.time = 1;
    this.asked = new Map(); // id -> how often something was asked to be shown: an answer that comes late must not win
  }

  /** Load all assets; `advance` is told after each. What cannot be drawn is left out and named. */
  async load(advance) {
    const failed = [];
    const rows = this.document.objects.filter((row) => row.placed);
    await Promise.all(
      rows.map(async (row) => {
        try {
          await this.#show(row.id, row.placed.blob, row.placed.scale);
        } catch (error) {
          failed.push(`${row.id}: ${error.message}`);
        }
        advance();
      }),
    );
    this.at(this.time);
    return failed;
  }

  /** Show a model in an object's place; whether it is shown: not where something else has been asked for since. */
  async #show(id, blob, scale) {
    const turn = this.#ask(id);
    const content = await model(blob);
    if (turn !== this.asked.get(id)) return false;
    const sized = new Group();
    sized.scale.set(...scale);
    sized.add(content);
    const holder = this.shown.get(id) ?? new Group();
    release(holder);
    holder.clear();
    holder.matrixAutoUpdate = false;
    holder.userData.instance = id;
    holder.add(sized);
    this.shown.set(id, holder);
    this.group.add(holder);
    return true;
  }

  #ask(id) {
    const turn = (this.asked.get(id) ?? 0) + 1;
    this.asked.set(id, turn);
    return turn;
  }

  /** Put all objects where they stand at a time; those that show another candidate stay. */
  at(time) {
    this.time = time;
    for (const [id, holder] of this.shown) {
      if (!this.tried.has(id)) holder.matrix.copy(poseAt(this.rows.get(id).placed.poses, time));
      holder.updateMatrixWorld(true);
    }
  }

  /** Show a candidate in an object's place, as selection aligned it; null shows again what was placed. Whether it is shown now. */
  async try(id, offer) {
    const row = this.rows.get(id);
    if (offer === null) {
      if (!row.placed) this.#hide(id);
      else if (!(await this.#show(id, row.placed.blob, row.placed.scale))) return false;
      this.tried.delete(id);
    } else {
      if (!(await this.#show(id, offer.blob, offer.scale))) return false;
      this.tried.set(id, offer.slot);
      this.shown.get(id).matrix.copy(pose(offer.pose));
    }
    this.at(this.time);
    return true;
  }

  #hide(id) {
    this.#ask(id);
    this.shown.get(id)?.removeFromParent();
    release(this.shown.get(id));
    this.shown.delete(id);
  }

  /** The instance that a mesh belongs to. */
  idOf(node) {
    for (let at = node; at; at = at.parent) if (at.userData.instance) return at.userData.instance;
    return null;
  }

  /** The box of an object as it is shown, or as it was scanned where nothing stands for it. */
  box(id) {
    const holder = this.shown.get(id);
    return holder ? boxOf(holder) : scannedBox(this.rows.get(id));
  }

  /** The box of everything. */
  get bounds() {
    const box = new Box3();
    for (const row of this.document.objects) box.union(this.box(row.id));
    return box;
  }

  /** Light up one object and nothing else. */
  tint(id, color) {
    for (const [each, holder] of this.shown) {
      for (const mesh of meshes(holder)) {
        if (!mesh.material.emissive) continue;
        mesh.material.emissive = new Color(each === id ? color : 0x000000);
        mesh.material.emissiveIntensity = each === id ? 0.2 : 0;
      }
    }
  }
}

/** The box of an object in the scan, upright in the world. */
export function scannedBox(row) {
  const [x, y, z] = row.box.size;
  const box = new Box3();
  box.min.set(-x / 2, -y / 2, -z / 2);
  box.max.set(x / 2, y / 2, z / 2);
  return box.applyMatrix4(new Matrix4().set(...row.box.pose));
}
