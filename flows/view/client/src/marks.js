// What is drawn over a scene: the selected object's box, what overlaps or does not stay, what carries what, colliders, the navmesh.

import {
  BoxGeometry, BufferGeometry, Color, CylinderGeometry, DoubleSide, EdgesGeometry, Group, Line, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, SphereGeometry, Vector3,
} from "three";
import { meshes, model, pose } from "./models.js";
import { source } from "./source.js";
import { poseAt } from "./replica.js";

export const SELECTED = 0x1f6feb;
export const WRONG = 0xd1242f;
const SHAKY = 0xe8890c;
export const DEEP_M = 0.002; // what overlaps by less is not counted as a deep pair
const RELATIONS = { floor: 0x6e7781, on: 0x1a7f37, inside: 0x8250df, wall: 0x0a7ea4, ceiling: 0x0a7ea4, none: WRONG };

const paints = new Map();

/** A material that is seen through everything. One for each color, kept: marks are made anew with every drawing of a settling. */
function over(color, Kind = LineBasicMaterial) {
  const key = `${Kind === LineBasicMaterial ? "line" : "face"} ${color}`;
  if (!paints.has(key)) paints.set(key, Object.assign(new Kind({ color, depthTest: false, transparent: true }), { userData: { isKept: true } }));
  return paints.get(key);
}

/** The turned box of an object in the scan. */
export function selection(row) {
  const box = new LineSegments(new EdgesGeometry(new BoxGeometry(...row.box.size)), over(SELECTED));
  box.matrixAutoUpdate = false;
  box.matrix.copy(pose(row.box.pose));
  return box;
}

/** Pairs that overlap more than is counted, at the time that is shown. */
export function overlaps(document_, time) {
  const phase = time < 0.5 ? "proposed" : "optimized";
  return document_.contacts.filter((row) => row.phase === phase && !row.allowed && row.depth > DEEP_M);
}

/** Marks on what overlaps (red) and what does not stay where it was put (orange). */
export function problems(document_, replica, time) {
  const group = new Group();
  for (const row of document_.objects) {
    if (row.unstable.length || row.remains) group.add(frame(replica.box(row.id), SHAKY));
  }
  for (const pair of overlaps(document_, time)) {
    const boxes = [pair.a, pair.b].filter((id) => replica.rows.has(id)).map((id) => replica.box(id));
    const [from, to] = [boxes[0], boxes[1] ?? boxes[0]].map((box) => box.getCenter(new Vector3()));
    group.add(dot(from.clone().lerp(to, 0.5), 0.05, WRONG), bar(from, to, WRONG));
    for (const box of boxes) group.add(frame(box, WRONG));
  }
  return group;
}

/** Lines from every object down, or over, to what carries it. */
export function supports(document_, replica) {
  const group = new Group();
  for (const row of document_.objects) {
    if (!row.support || !replica.shown.has(row.id)) continue;
    const box = replica.box(row.id);
    const middle = box.getCenter(new Vector3());
    const parent = row.support.parent;
    let end = new Vector3(middle.x, middle.y, 0);
    if (parent && replica.rows.has(parent)) end = replica.box(parent).getCenter(new Vector3());
    else if (row.support.relation === "ceiling") end = new Vector3(middle.x, middle.y, document_.room?.height ?? box.max.z);
    else if (row.support.relation === "wall") end = onWall(middle, document_.room) ?? middle;
    const color = RELATIONS[row.support.relation];
    group.add(bar(middle, end, color), dot(middle, 0.025, color), dot(end, 0.04, color));
  }
  return group;
}

/** Convex pieces of all objects as the simulators get them, at the time that is shown. Objects without any are counted. */
export class Colliders {
  constructor(document_) {
    this.document = document_;
    this.group = new Group();
    this.holders = new Map();
  }

  get missing() {
    return this.document.objects.filter((row) => row.placed && !row.collider).length;
  }

  async load() {
    await Promise.all(
      this.document.objects.filter((row) => row.placed && row.collider).map(async (row) => {
        const pieces = await model(row.collider);
        meshes(pieces).forEach((mesh, index) => {
          const color = new Color().setHSL((index * 0.381966) % 1, 0.65, 0.55);
          mesh.material = new MeshLambertMaterial({ color, transparent: true, opacity: 0.85, flatShading: true, side: DoubleSide });
        });
        const holder = new Group();
        holder.matrixAutoUpdate = false;
        holder.add(pieces);
        this.holders.set(row.id, holder);
        this.group.add(holder);
      }),
    );
    return this;
  }

  at(time) {
    for (const row of this.document.objects) this.holders.get(row.id)?.matrix.copy(poseAt(row.placed.poses, time));
    this.group.updateMatrixWorld(true);
  }
}

/** Where an agent can go, just above the floor. */
export async function navmesh(row) {
  const { points, triangles } = JSON.parse(new TextDecoder().decode(await source.bytes(row.blob)));
  const geometry = new BufferGeometry().setFromPoints(points.map(([x, y]) => new Vector3(x, y, 0.015)));
  geometry.setIndex(triangles.flat());
  const face = new Mesh(geometry, new MeshBasicMaterial({ color: 0x2da44e, transparent: true, opacity: 0.35, side: DoubleSide, depthWrite: false }));
  return new Group().add(face, new LineSegments(new EdgesGeometry(geometry), new LineBasicMaterial({ color: 0x1a7f37 })));
}

/** A line through points, seen through everything. */
export function line(points, color) {
  return new Line(new BufferGeometry().setFromPoints(points), over(color));
}

/** A dot, seen through everything. */
export function dot(place, radius, color) {
  const mesh = new Mesh(new SphereGeometry(radius, 12, 8), over(color, MeshBasicMaterial));
  mesh.position.copy(place);
  return mesh;
}

/** A thin bar between two points, seen through everything. */
function bar(from, to, color) {
  const length = from.distanceTo(to);
  const mesh = new Mesh(new CylinderGeometry(0.009, 0.009, length, 6), over(color, MeshBasicMaterial));
  mesh.position.copy(from).lerp(to, 0.5);
  mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), to.clone().sub(from).normalize());
  return mesh;
}

function frame(box, color) {
  const size = box.getSize(new Vector3());
  const edges = new LineSegments(new EdgesGeometry(new BoxGeometry(size.x, size.y, size.z)), over(color));
  edges.position.copy(box.getCenter(new Vector3()));
  return edges;
}

/** The point of a room's walls nearest to a point, at its height. */
function onWall(point, room) {
  let best = null;
  for (const [x0, y0, x1, y1] of room?.walls ?? []) {
    const [dx, dy] = [x1 - x0, y1 - y0];
    const along = Math.min(1, Math.max(0, ((point.x - x0) * dx + (point.y - y0) * dy) / (dx * dx + dy * dy || 1)));
    const foot = new Vector3(x0 + along * dx, y0 + along * dy, point.z);
    if (best === null || foot.distanceTo(point) < best.distanceTo(point)) best = foot;
  }
  return best;
}
