// The scan as mesh or points, and the shell of the replica: one looks into the room over the walls before the camera.

import { Box3, BufferAttribute, BufferGeometry, Group, Mesh, Points, PointsMaterial, Vector3 } from "three";
import { meshes, model, unlit } from "./models.js";

const MANY_FACES = 60_000;
const CELL_M = 0.06;
const POINT_M = 0.03;
const FEW_POINTS = 25_000;

/** The scan of a scene. */
export class Scan {
  constructor(group) {
    this.group = group;
    this.mesh = new Group();
    this.points = null;
    group.add(this.mesh);
  }

  static async of(document_, group) {
    const scan = new Scan(group);
    const root = await model(document_.scan);
    for (const mesh of meshes(root)) mesh.material = unlit(mesh.material);
    root.updateMatrixWorld(true);
    scan.mesh.add(root);
    return scan;
  }

  /** Draw a coarse form of a large scan, for as long as pictures follow one another; `isSlow`: where whole ones take too long. */
  quick(wanted, isSlow) {
    const most = wanted && isSlow ? FEW_POINTS : Infinity;
    for (const { geometry } of this.points?.children ?? []) geometry.setDrawRange(0, most);
    for (const mesh of this.points ? [] : meshes(this.mesh)) {
      const { fine = mesh.geometry } = mesh.userData;
      const faces = (fine.index ?? fine.attributes.position).count / 3;
      const isCoarse = wanted && isSlow && faces > MANY_FACES && !mesh.material.map;
      if (isCoarse && !mesh.userData.coarse) Object.assign(mesh.userData, { fine, coarse: clustered(fine, CELL_M) });
      mesh.geometry = isCoarse ? mesh.userData.coarse : fine;
    }
  }

  /** Vertices of the scan. */
  get count() {
    return meshes(this.mesh).reduce((sum, mesh) => sum + mesh.geometry.attributes.position.count, 0);
  }

  /** Draw points instead of faces, or faces again. */
  asPoints(wanted) {
    if (wanted && this.points === null) this.#makePoints();
    if (this.points) this.points.visible = wanted;
    this.mesh.visible = !wanted;
  }

  /** How large points are drawn [m]. */
  pointSize(metres) {
    for (const { material } of this.points?.children ?? []) material.size = metres;
  }

  /** Points that are turned away are left out, as faces are. */
  #makePoints() {
    this.points = new Group();
    for (const mesh of meshes(this.mesh)) {
      if (!mesh.geometry.attributes.normal) mesh.geometry.computeVertexNormals();
      const geometry = new BufferGeometry();
      for (const name of ["position", "normal", "color"]) {
        if (mesh.geometry.attributes[name]) geometry.setAttribute(name, mesh.geometry.attributes[name]);
      }
      geometry.setIndex(new BufferAttribute(shuffled(geometry.attributes.position.count), 1)); // any first part of them is the scan, coarsely
      const material = new PointsMaterial({ size: POINT_M, vertexColors: "color" in geometry.attributes });
      if (!material.vertexColors) material.color.set(0x8a94a2);
      material.onBeforeCompile = (shader) => {
        const away = "vec3 toEye = -mvPosition.xyz; if (dot(normalMatrix * normal, toEye) < 0.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);";
        shader.vertexShader = shader.vertexShader.replace("#include <fog_vertex>", `#include <fog_vertex>\n${away}`);
      };
      const points = new Points(geometry, material);
      points.matrixAutoUpdate = false;
      points.matrix.copy(mesh.matrixWorld);
      this.points.add(points);
    }
    this.group.add(this.points);
  }
}

/** Numbers below a count, each once, in an order that is the same every time: steps that share no factor with it. */
function shuffled(count) {
  const order = new Uint32Array(count);
  let step = Math.max(1, Math.round(count * 0.618034));
  const factor = (a, b) => (b ? factor(b, a % b) : a);
  while (factor(step, count) > 1) step += 1;
  for (let place = 0, number = 0; place < count; place += 1, number = (number + step) % count) order[place] = number;
  return order;
}

/** A mesh with one vertex for each cell of a grid: faces within a cell are gone. */
function clustered(geometry, edge) {
  const { position, color } = geometry.attributes;
  const cells = new Map();
  const kept = [];
  const owner = new Uint32Array(position.count);
  for (let vertex = 0; vertex < position.count; vertex += 1) {
    const [x, y, z] = [position.getX(vertex), position.getY(vertex), position.getZ(vertex)].map((at) => Math.round(at / edge) + 4096);
    const key = (x * 8192 + y) * 8192 + z;
    let cell = cells.get(key);
    if (cell === undefined) {
      cell = kept.push(vertex) - 1;
      cells.set(key, cell);
    }
    owner[vertex] = cell;
  }
  const faces = [];
  const corner = geometry.index ? (at) => owner[geometry.index.getX(at)] : (at) => owner[at];
  for (let at = 0; at < (geometry.index ?? position).count; at += 3) {
    const [a, b, c] = [corner(at), corner(at + 1), corner(at + 2)];
    if (a !== b && b !== c && c !== a) faces.push(a, b, c);
  }
  const taken = (attribute) => {
    const made = new attribute.array.constructor(kept.length * attribute.itemSize);
    kept.forEach((vertex, index) => {
      for (let i = 0; i < attribute.itemSize; i += 1) made[index * attribute.itemSize + i] = attribute.array[vertex * attribute.itemSize + i];
    });
    return new BufferAttribute(made, attribute.itemSize, attribute.normalized);
  };
  const coarse = new BufferGeometry();
  coarse.setAttribute("position", taken(position));
  if (color) coarse.setAttribute("color", taken(color));
  coarse.setIndex(faces);
  return coarse;
}

/** The shell of a replica by part; walls say where their inner side is, so that one looks over those before the camera. */
export async function shellOf(document_) {
  const shell = new Group();
  const facing = [];
  if (!document_.shell) return { shell, facing };
  const root = await model(document_.shell);
  root.updateMatrixWorld(true);
  for (const mesh of meshes(root)) {
    const material = mesh.material.map ? unlit(mesh.material) : mesh.material; // images of the scan have been lit already
    const part = new Mesh(mesh.geometry.clone().applyMatrix4(mesh.matrixWorld), material);
    part.name = partName(mesh);
    shell.add(part);
    const number = /^wall_(\d+)/.exec(part.name);
    const side = number && sideOf(document_.room.polygon, Number(number[1]));
    if (side) facing.push({ objects: () => [part], wall: number[0], ...side });
  }
  return { shell, facing };
}

/** The name of a part: of the node, or of the node that holds the mesh. */
function partName(mesh) {
  const names = [mesh.name, mesh.parent?.name ?? ""];
  return names.find((name) => /^(floor|wall|inner|ceiling)/.test(name)) ?? names[0];
}

/** A point of an edge of a counter-clockwise ring, and the direction from it into the ring. */
function sideOf(ring, index) {
  if (index >= ring.length) return null;
  const [[x0, y0], [x1, y1]] = [ring[index], ring[(index + 1) % ring.length]];
  const length = Math.hypot(x1 - x0, y1 - y0);
  return length ? { point: new Vector3(x0, y0, 0), normal: new Vector3(-(y1 - y0) / length, (x1 - x0) / length, 0) } : null;
}

/** The box of a room. */
export function roomBox(room) {
  const box = new Box3();
  for (const [x, y] of room.polygon) box.expandByPoint(new Vector3(x, y, 0));
  box.max.z = Math.min(room.height, 2.2);
  return box;
}
