// GLB files as three.js objects in the world frame of the lake: metres, +Z up.

import { Box3, FrontSide, Group, Matrix4, MeshBasicMaterial, MeshLambertMaterial, Quaternion, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { source } from "./source.js";

const loader = new GLTFLoader();
const loaded = new Map();
const shared = new WeakSet(); // geometries that every copy of a model draws

/** A GLB by the name of its blob, +Y up turned to +Z up. Loaded once; every call gives a copy with materials of its own. */
export async function model(name) {
  if (!loaded.has(name)) {
    const reading = read(name);
    loaded.set(name, reading);
    reading.catch(() => loaded.get(name) === reading && loaded.delete(name)); // asked for again the next time
  }
  const copy = (await loaded.get(name)).clone(true);
  for (const mesh of meshes(copy)) mesh.material = matte(mesh.material);
  const turned = new Group();
  turned.rotation.x = Math.PI / 2;
  turned.add(copy);
  return turned;
}

async function read(name) {
  const { scene } = await loader.parseAsync(await source.bytes(name), "");
  for (const { geometry } of meshes(scene)) shared.add(geometry);
  return scene;
}

/** The colors and images of a material without gloss: what has no material in its file would be a dark metal. */
function matte(material) {
  const { map, vertexColors, side, transparent, opacity, alphaTest, flatShading, emissive, emissiveMap } = material;
  const made = new MeshLambertMaterial({ map, vertexColors, side, transparent, opacity, alphaTest, flatShading, emissiveMap });
  made.color.copy(material.color);
  if (emissive) made.emissive.copy(emissive);
  return made;
}

/** Forget what was loaded: another scene has other models. What the graphics processor holds of it is given back. */
export function forget() {
  for (const reading of loaded.values()) {
    reading.then((scene) => {
      for (const { geometry, material } of meshes(scene)) {
        geometry.dispose();
        for (const value of Object.values(material)) if (value?.isTexture) value.dispose();
      }
    }, () => {});
  }
  loaded.clear();
}

/** Give back what the graphics processor holds of an object, but for what other copies of its model draw. */
export function release(root) {
  root?.traverse(({ geometry, material, userData }) => {
    for (const each of [geometry, userData.fine, userData.coarse]) if (each && !shared.has(each)) each.dispose();
    if (material && !material.userData.isKept) material.dispose();
  });
}

/** Meshes below an object. */
export function meshes(root) {
  const found = [];
  root.traverse((node) => node.isMesh && found.push(node));
  return found;
}

/** A 4x4 matrix from 16 numbers row by row. */
export const pose = (numbers) => new Matrix4().set(...numbers);

/** A pose between two: its place on the line, its turn on the shortest arc. */
export function between(from, to, share) {
  const parts = [from, to].map((matrix) => {
    const [place, turn, size] = [new Vector3(), new Quaternion(), new Vector3()];
    matrix.decompose(place, turn, size);
    return { place, turn };
  });
  const place = parts[0].place.lerp(parts[1].place, share);
  const turn = parts[0].turn.slerp(parts[1].turn, share);
  return new Matrix4().compose(place, turn, new Vector3(1, 1, 1));
}

/** The box of an object in the world. */
export const boxOf = (object) => new Box3().setFromObject(object);

/** The same colors without light: those of a scan have been lit already. Seen from the front only, so that one looks into rooms. */
export function unlit(material) {
  const plain = new MeshBasicMaterial({ vertexColors: material.vertexColors, map: material.map ?? null, side: FrontSide });
  plain.color.copy(material.color);
  return plain;
}

