// What lies below an object, so that it can be put down on it.

import { Box3, Raycaster, Vector3 } from "three";
import { poseOf } from "./draft.js";

const SHARES = [-0.42, 0, 0.42]; // of the footprint's length and width, where is felt for what lies below
const DOWN = new Vector3(0, 0, -1);

/** Height of the highest of some objects below a scaled asset [m], the floor at least; felt from half its height downwards. */
export function supportBelow(transform, extents, objects) {
  const pose = poseOf(transform);
  const size = extents.map((length, axis) => length * transform.scale[axis]);
  const feet = SHARES.flatMap((x) => SHARES.map((y) => new Vector3(x * size[0], y * size[1], size[2] / 2).applyMatrix4(pose)));
  const above = new Box3().setFromPoints(feet);
  const start = above.max.z;
  const beneath = objects.filter((object) => {
    const box = new Box3().setFromObject(object);
    return box.min.x < above.max.x && box.max.x > above.min.x && box.min.y < above.max.y && box.max.y > above.min.y && box.min.z < start;
  });
  let height = 0;
  if (!beneath.length) return height;
  const ray = new Raycaster();
  for (const foot of feet) {
    ray.set(foot.setZ(start), DOWN);
    const hit = ray.intersectObjects(beneath, true)[0];
    if (hit) height = Math.max(height, hit.point.z);
  }
  return height;
}
