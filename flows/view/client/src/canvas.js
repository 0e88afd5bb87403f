// The canvas: scan and replica side by side behind a movable edge, drawn when something has changed and not otherwise.

import {
  AmbientLight, Color, DirectionalLight, HemisphereLight, PerspectiveCamera, Raycaster, Scene, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const CLICK_PX = 5;
const ELEVATION = 0.82; // radians above the floor from which a room is seen at first
const REST_MS = 250;
const SLOW_MS = 50;
const INSET = { width: 256, height: 192, margin: 12 };

export class Canvas {
  constructor(place) {
    this.renderer = new WebGLRenderer({ antialias: true, powerPreference: "high-performance" });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.autoClear = false;
    this.node = this.renderer.domElement;
    this.node.tabIndex = 0;
    this.node.setAttribute("role", "application");
    this.node.setAttribute("aria-label", "The scene in 3D: drag to turn, right drag to move, wheel to come nearer, click an object");
    place.append(this.node);
    this.scan = new Scene();
    this.replica = new Scene();
    this.marks = new Scene();
    this.replica.add(new HemisphereLight(0xffffff, 0xb8aea0, 1.5), new AmbientLight(0xffffff, 0.6));
    const sun = new DirectionalLight(0xffffff, 1.2);
    sun.position.set(3, -4, 8);
    this.replica.add(sun);
    this.camera = new PerspectiveCamera(45, 1, 0.02, 200);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.node);
    this.controls.maxPolarAngle = Math.PI * 0.95;
    this.controls.minDistance = 0.2;
    this.controls.addEventListener("change", () => this.draw());
    let rest = 0;
    this.controls.addEventListener("start", () => {
      clearTimeout(rest);
      this.isMoving = true;
    });
    this.controls.addEventListener("end", () => {
      rest = setTimeout(() => {
        this.isMoving = false;
        this.draw();
      }, REST_MS);
    });
    this.cut = 0.5; // share of the width that shows the scan
    this.agent = null; // camera of the inset
    this.facing = []; // { objects, point, normal }: seen only from the side that the normal points to
    this.quick = () => {}; // told before a drawing whether another follows at once, and whether drawings take long here
    this.isSlow = false;
    this.isMoving = false;
    this.isPlaying = false;
    this.isHeld = false; // while much is loaded: drawn for a moving hand alone
    this.frames = 0;
    this.isDirty = false;
    new ResizeObserver(() => this.#resize()).observe(place);
    this.#listen();
  }

  /** Background as the page's. */
  paper(color) {
    this.renderer.setClearColor(new Color(color));
    this.draw();
  }

  /** Draw soon; many calls are one drawing. */
  draw() {
    if (this.isDirty || (this.isHeld && !this.isMoving)) return;
    this.isDirty = true;
    requestAnimationFrame(() => {
      this.isDirty = false;
      this.#render();
    });
  }

  /** Put the camera where a whole box, an object or a room, is seen; `from`: direction to the camera. */
  look(box, from = null) {
    const middle = box.getCenter(new Vector3());
    const direction = (from ?? this.camera.position.clone().sub(this.controls.target)).normalize();
    const right = new Vector3().crossVectors(new Vector3(0, 0, 1), direction).normalize();
    const up = new Vector3().crossVectors(direction, right);
    const high = Math.tan((this.camera.fov * Math.PI) / 360) * 0.94;
    const wide = high * this.camera.aspect;
    let distance = 0.6;
    for (const corner of corners(box)) {
      const away = corner.sub(middle);
      const ahead = away.dot(direction);
      distance = Math.max(distance, ahead + Math.abs(away.dot(right)) / wide, ahead + Math.abs(away.dot(up)) / high);
    }
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).addScaledVector(direction, distance);
    this.controls.update();
    this.camera.updateMatrixWorld(); // what is asked before the next drawing is of this place
    this.draw();
  }

  /** A direction from which tall things hide the least: they stand on the far side. */
  direction(box, objects) {
    const middle = box.getCenter(new Vector3());
    const turns = [1, 3, 5, 7].map((eighth) => (eighth * Math.PI) / 4);
    const hidden = (turn) =>
      objects.reduce((sum, at) => {
        const size = at.getSize(new Vector3());
        const away = at.getCenter(new Vector3()).sub(middle);
        return sum + size.z ** 2 * (away.x * Math.cos(turn) + away.y * Math.sin(turn));
      }, 0);
    const turn = turns.reduce((best, each) => (hidden(each) < hidden(best) ? each : best));
    return new Vector3(Math.cos(turn) * Math.cos(ELEVATION), Math.sin(turn) * Math.cos(ELEVATION), Math.sin(ELEVATION));
  }

  /** The first of some objects under a place of the canvas [px], with the point where it was met. */
  pick(x, y, targets) {
    const { width, height } = this.node.getBoundingClientRect();
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2((x / width) * 2 - 1, 1 - (y / height) * 2), this.camera);
    return ray.intersectObjects(targets, true)[0] ?? null;
  }

  /** Where a point of the world lies on the page [px]. */
  project(point) {
    const { left, top, width, height } = this.node.getBoundingClientRect();
    const seen = point.clone().project(this.camera);
    return { x: left + ((seen.x + 1) / 2) * width, y: top + ((1 - seen.y) / 2) * height };
  }

  /** `click` and `hover` get places on the canvas [px]. */
  onPointer(click, hover) {
    this.click = click;
    this.hover = hover;
  }

  #listen() {
    let start = null;
    this.node.addEventListener("pointerdown", (event) => {
      start = [event.clientX, event.clientY];
    });
    this.node.addEventListener("pointerup", (event) => {
      const moved = start && Math.hypot(event.clientX - start[0], event.clientY - start[1]);
      start = null;
      if (event.button === 0 && moved !== null && moved < CLICK_PX) this.click?.(event.offsetX, event.offsetY);
    });
    this.node.addEventListener("pointermove", (event) => {
      if (!event.buttons) this.hover?.(event.offsetX, event.offsetY);
    });
    this.node.addEventListener("pointerleave", () => this.hover?.(null, null));
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.node.parentElement;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Find out whether drawings take long here, as they do without a graphics processor. */
  measure() {
    const pixel = new Uint8Array(4);
    const context = this.renderer.getContext();
    const begun = performance.now();
    this.#render();
    context.readPixels(0, 0, 1, 1, context.RGBA, context.UNSIGNED_BYTE, pixel); // waits until all is drawn
    this.isSlow = performance.now() - begun > SLOW_MS;
  }

  #render() {
    this.quick(this.isMoving || this.isPlaying, this.isSlow);
    const { renderer, camera } = this;
    const { x: width, y: height } = renderer.getSize(new Vector2());
    const edge = Math.round(width * this.cut);
    renderer.setViewport(0, 0, width, height);
    renderer.setScissorTest(false);
    renderer.clear();
    renderer.setScissorTest(true);
    this.#face(camera);
    if (edge > 0) {
      renderer.setScissor(0, 0, edge, height);
      renderer.render(this.scan, camera);
    }
    if (edge < width) {
      renderer.setScissor(edge, 0, width - edge, height);
      renderer.render(this.replica, camera);
    }
    renderer.setScissorTest(false);
    renderer.render(this.marks, camera);
    if (this.agent) this.#inset(width, height);
    this.frames += 1;
  }

  /** Hide what stands with its back to a camera: walls that one looks over, with what hangs on them. */
  #face(camera) {
    for (const { objects, point, normal, stays } of this.facing) {
      const isSeen = (stays?.() ?? false) || camera.position.clone().sub(point).dot(normal) > 0;
      for (const object of objects()) object.visible = isSeen;
    }
  }

  #inset(width, height) {
    const [x, y] = [width - INSET.width - INSET.margin, height - INSET.height - INSET.margin];
    this.agent.aspect = INSET.width / INSET.height;
    this.agent.updateProjectionMatrix();
    this.renderer.setViewport(x, y, INSET.width, INSET.height);
    this.renderer.setScissor(x, y, INSET.width, INSET.height);
    this.renderer.setScissorTest(true);
    this.renderer.clear();
    this.beforeInset?.(true);
    this.#face(this.agent);
    this.renderer.render(this.replica, this.agent);
    this.beforeInset?.(false);
    this.renderer.setScissorTest(false);
  }
}

/** The eight corners of a box. */
function corners(box) {
  const { min, max } = box;
  return [0, 1, 2, 3, 4, 5, 6, 7].map((i) => new Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z));
}
