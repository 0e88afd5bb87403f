// Small pictures of models, drawn one after the other by a small renderer of their own.

import { AmbientLight, Box3, DirectionalLight, Group, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { model } from "./models.js";

const EDGE = 112;
const FROM = new Vector3(0.8, 0.42, 0.46).normalize(); // before the front (+x), a little to its side and above
let renderer = null;
let queue = Promise.resolve();

/** Draw a candidate into a canvas element. Resolves when it is drawn. */
export function thumbnail(offer, canvas) {
  queue = queue.then(() => draw(offer, canvas)).catch(() => canvas.classList.add("broken"));
  return queue;
}

async function draw(offer, canvas) {
  if (!canvas.isConnected) return; // the panel shows something else by now
  const content = await model(offer.blob);
  const holder = new Group();
  holder.scale.set(...(offer.scale ?? [1, 1, 1]));
  holder.add(content);
  const scene = new Scene().add(holder, new AmbientLight(0xffffff, 1.6));
  const sun = new DirectionalLight(0xffffff, 2.2);
  sun.position.set(2, 1, 3);
  scene.add(sun);
  const box = new Box3().setFromObject(holder);
  const middle = box.getCenter(new Vector3());
  const radius = box.getSize(new Vector3()).length() / 2;
  const camera = new PerspectiveCamera(24, 1, radius / 10, radius * 20);
  camera.up.set(0, 0, 1);
  camera.position.copy(middle).addScaledVector(FROM, (radius / Math.sin((12 * Math.PI) / 180)) * 0.92);
  camera.lookAt(middle);
  if (renderer === null) {
    renderer = new WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    renderer.setSize(EDGE, EDGE, false);
    renderer.setClearAlpha(0);
  }
  renderer.render(scene, camera);
  canvas.width = canvas.height = EDGE;
  canvas.getContext("2d").drawImage(renderer.domElement, 0, 0);
  canvas.dataset.drawn = "true";
}

