// The scene in 3D: the scan as points, what stands in the room, and the object that is being answered for, with its handles.

import { Box3, Group, Points, PointsMaterial, Vector3 } from "three";
import { PLYLoader } from "three/addons/loaders/PLYLoader.js";
import { Canvas } from "../canvas.js";
import { SELECTED, selection } from "../marks.js";
import { forget, release } from "../models.js";
import { Player } from "../player.js";
import { Replica } from "../replica.js";
import { roomBox, Scan, shellOf } from "../room.js";
import { ask, keyPath } from "./server.js";
import { poseOf, transformAt } from "./draft.js";
import { Gizmo } from "./gizmo.js";
import { supportBelow } from "./support.js";

export const SCAN_MODES = ["over", "beside", "scan", "replica"];
const FOV_DEGREES = 45;
const POINT_M = { over: 0.018, beside: 0.03, scan: 0.03, replica: 0.03 }; // over the replica they must not hide it
const OWN_POINT_M = 0.012;
const OWN_COLOR = 0xe8590c;
const LEAST_SLOPE = 0.25;
const GLIDE_SECONDS = 0.5;
const CLEARLY_NEARER = 0.05;

export class Stage {
  /** `on`: `moved(transform)`, `moveDone()`, `picked(instance)`, `turned()`, `say(text, isWrong)`. */
  constructor(place, on) {
    this.on = on;
    this.canvas = new Canvas(place);
    this.canvas.onPointer((x, y) => this.#clicked(x, y), () => {});
    this.canvas.paper(getComputedStyle(document.documentElement).getPropertyValue("--view").trim() || "#eef1f5");
    this.canvas.controls.addEventListener("change", () => this.#turned());
    this.gizmo = new Gizmo(this.canvas, (transform) => on.moved(transform), () => on.moveDone());
    Object.assign(this, { document: null, draft: null, loading: 0, showing: 0, mode: "over", hasHandles: false, drawn: new Map() });
    this.own = new Group(); // marks of the selected object: its scanned box and points
    this.canvas.marks.add(this.own);
  }

  get scene() {
    return this.document?.id ?? null;
  }

  /** Load a scene, the draft that is asked for first, then all else; `drafts`: those of its objects by instance. */
  async open(scene, drafts, first) {
    const turn = (this.loading += 1);
    this.#clear();
    this.on.say(`Loading ${scene} …`);
    const told = await ask("GET", `scenes/${keyPath(scene)}`);
    if (turn !== this.loading) return;
    const objects = told.objects.map((row) => ({ ...row, placed: drafts.has(row.id) ? null : standing(row) }));
    this.document = { ...told, objects };
    this.drafts = drafts;
    this.replica = new Replica(this.document, this.objects);
    const room = shellOf(told).then(({ shell, facing }) => {
      if (turn !== this.loading) return;
      this.shell = shell;
      this.canvas.replica.add(shell);
      this.canvas.facing = facing;
      this.canvas.draw();
    });
    await this.show(drafts.get(first));
    if (turn !== this.loading) return;
    this.look("object");
    this.canvas.isHeld = true;
    const scanning = told.scan ? Scan.of(told, this.scanGroup) : Promise.resolve(null);
    scanning.catch(() => {}); // told of below
    const failed = await this.replica.load(() => {});
    if (turn !== this.loading) return;
    await Promise.all([room, ...[...drafts.values()].filter((draft) => draft !== this.draft).map((draft) => this.#stand(draft))]);
    const scan = await scanning;
    if (turn !== this.loading) return;
    this.scan = scan;
    scan?.asPoints(true);
    this.canvas.quick = (wanted, isSlow) => scan?.quick(wanted, isSlow);
    this.scanMode(this.mode);
    this.canvas.isHeld = false;
    this.canvas.measure();
    this.on.say(failed.length ? `Cannot be drawn: ${failed.join("; ")}` : "", failed.length > 0);
    document.documentElement.dataset.ready = scene;
  }

  #clear() {
    forget();
    delete document.documentElement.dataset.ready;
    this.canvas.facing = [];
    this.canvas.quick = () => {};
    this.canvas.isHeld = false;
    this.glide?.pause();
    for (const group of [this.scanGroup, this.shell, this.objects]) release(group?.removeFromParent());
    [this.scanGroup, this.objects] = [new Group(), new Group()];
    this.canvas.replica.add(this.objects);
    Object.assign(this, { document: null, draft: null, scan: null, shell: null });
    this.drawn.clear();
    this.gizmo.at(null);
    this.#mark(null);
    this.scanMode(this.mode);
  }

  /** How the scan is seen: as points over the replica, beside it behind an edge, alone, or not at all. */
  scanMode(mode) {
    this.mode = mode;
    const { scan, replica } = this.canvas;
    (mode === "over" ? replica : scan).add(this.scanGroup);
    this.scan?.pointSize(POINT_M[mode]);
    this.cut({ over: 0, beside: 0.5, scan: 1, replica: 0 }[mode]);
  }

  /** Share of the picture that shows the scan. */
  cut(share) {
    this.canvas.cut = share;
    this.canvas.node.parentElement.style.setProperty("--cut", `${share * 100}%`);
    this.canvas.draw();
  }

  /** Put the object of a draft before the user. */
  async show(draft) {
    const turn = (this.showing += 1);
    this.glide?.pause();
    this.draft = draft ?? null;
    this.photo = draft?.row.photos[0] ?? null;
    this.#mark(draft);
    this.gizmo.at(null);
    if (draft) await this.#stand(draft);
    if (turn !== this.showing || !this.replica) return;
    this.replica.tint(draft ? idOf(draft) : null, SELECTED);
    this.#handles();
    this.canvas.draw();
  }

  /** Draw a draft's candidate where it stands; another model only where another one is chosen. */
  async #stand(draft) {
    const [id, offer] = [idOf(draft), draft.chosen];
    const { replica } = this;
    if (!replica?.rows.has(id)) return;
    if (this.drawn.get(id) !== (offer?.slot ?? null) || !replica.shown.has(id)) {
      this.drawn.set(id, offer?.slot ?? null);
      try {
        const { transform } = draft;
        const shown = offer && { slot: offer.slot, blob: nameOf(offer.glb), scale: transform.scale, pose: poseOf(transform).clone().transpose().elements };
        if (!(await replica.try(id, shown)) || replica !== this.replica) return;
        if (draft === this.draft) replica.tint(id, SELECTED);
      } catch (error) {
        this.drawn.delete(id);
        this.on.say(`${draft.row.category} ${id}: ${error.message}`, true);
        return;
      }
    }
    if (draft.transform && this.drawn.get(id) === draft.now.choice) this.#put(id, draft.transform);
  }

  #put(id, transform) {
    const holder = this.replica.shown.get(id);
    if (!holder) return;
    holder.matrix.copy(poseOf(transform));
    holder.children[0].scale.set(...transform.scale);
    holder.updateMatrixWorld(true);
    this.canvas.draw();
  }

  /** The draft has changed: draw it as it is now. */
  async follow() {
    this.glide?.pause();
    const { draft } = this;
    if (!draft) return;
    await this.#stand(draft);
    if (draft === this.draft) this.#handles();
    this.canvas.draw();
  }

  /** While something is dragged: only where it stands. */
  drag(transform) {
    this.glide?.pause();
    if (!this.draft) return;
    this.#put(idOf(this.draft), transform);
    this.gizmo.at(transform);
  }

  /** Let the object glide from one place to another. */
  slide(from, to) {
    this.glide?.pause();
    const id = idOf(this.draft);
    const end = () => {
      this.canvas.isPlaying = false;
      this.#put(id, to);
      this.#handles();
    };
    this.glide = new Player(1, GLIDE_SECONDS, (share) => this.#put(id, transformAt(from, to, share)), end);
    this.canvas.isPlaying = true;
    this.glide.play();
  }

  /** Show the handles that move, turn or scale, or none. */
  handles(on, mode = null) {
    this.hasHandles = on;
    if (mode) this.gizmo.mode(mode);
    this.#handles();
    this.canvas.draw();
  }

  #handles() {
    this.gizmo.at(this.hasHandles && this.draft?.transform ? this.draft.transform : null);
  }

  /** Height of what lies below a draft's candidate where it would stand [m]. */
  support(draft, transform) {
    const id = idOf(draft);
    const rest = [...(this.replica?.shown ?? [])].filter(([each]) => each !== id).map(([, holder]) => holder);
    return supportBelow(transform, draft.chosen.extents, rest);
  }

  /**
   * Where the camera stands: `object` from the photo's side, as it is seen from there, `near` as one looks now, `corner` and `above`
   * of the room, or `photo`, where the photo was taken.
   */
  look(how) {
    const { canvas, draft } = this;
    const isPhoto = how === "photo";
    const camera = (isPhoto ? this.photo : draft?.row.photos[0])?.camera ?? null;
    if (isPhoto && !camera) return;
    canvas.camera.fov = isPhoto ? camera.fov_degrees : FOV_DEGREES;
    canvas.camera.updateProjectionMatrix();
    if (isPhoto) {
      canvas.camera.position.set(...camera.position);
      canvas.controls.target.set(...camera.target);
      canvas.controls.update();
      canvas.camera.updateMatrixWorld();
      canvas.draw();
      this.#turned();
      return;
    }
    if ((how === "object" || how === "near") && draft) {
      const box = this.#boxOf(draft);
      box.expandByScalar(Math.max(0.2, box.getSize(new Vector3()).length() * 0.35));
      canvas.look(box, how === "near" ? null : camera ? fromPhoto(camera) : canvas.direction(box, []));
      return;
    }
    const box = this.document?.room ? roomBox(this.document.room) : (this.replica?.bounds ?? new Box3());
    if (box.isEmpty()) return;
    const boxes = this.document.objects.map((row) => this.replica.box(row.id));
    canvas.look(box, how === "above" ? new Vector3(0, -0.02, 1) : canvas.direction(box, boxes));
  }

  #boxOf(draft) {
    const box = scanned(draft.row.box);
    const holder = this.replica?.shown.get(idOf(draft));
    return holder ? box.union(new Box3().setFromObject(holder)) : box;
  }

  /** How far the view is turned from the photo's camera about the vertical, to the right above 0 [degrees]; null without one. */
  get aside() {
    const camera = this.photo?.camera;
    if (!camera) return null;
    const [view, target] = [this.canvas.camera.position, this.canvas.controls.target];
    const here = Math.atan2(view.y - target.y, view.x - target.x);
    const there = Math.atan2(camera.position[1] - camera.target[1], camera.position[0] - camera.target[0]);
    const degrees = ((here - there) * 180) / Math.PI;
    return ((degrees + 540) % 360) - 180;
  }

  /** Of the photos the one that looks as the view does; another one only where it is clearly nearer, so that none flickers. */
  #turned() {
    const { canvas, photo } = this;
    const view = canvas.camera.position.clone().sub(canvas.controls.target);
    const off = (each) => view.angleTo(away(each.camera));
    const nearest = (this.draft?.row.photos ?? []).reduce((best, each) => (best && off(best) <= off(each) ? best : each), null);
    if (nearest && photo && off(nearest) < off(photo) - CLEARLY_NEARER) this.photo = nearest;
    this.on.turned();
  }

  /** The picture of the photo that is shown is not there any more: it is none of the object's photos, but the best view stays. */
  losePhoto() {
    const { draft, photo } = this;
    if (!draft || photo === draft.row.photos[0]) return;
    draft.row.photos = draft.row.photos.filter((each) => each !== photo);
    this.photo = draft.row.photos[0];
    this.#turned();
  }

  #clicked(x, y) {
    if (!this.replica || this.gizmo.isTaken) return;
    const hit = this.canvas.pick(x, y, [...this.replica.shown.values()].filter((holder) => holder.visible));
    const id = hit && this.replica.idOf(hit.object);
    if (id) this.on.picked(id);
  }

  /** Draw the scanned box of an object and the points that are its own. */
  #mark(draft) {
    release(this.own);
    this.own.clear();
    if (!draft) return;
    const { center, yaw_degrees: degrees, size } = draft.row.box;
    const half = (degrees * Math.PI) / 360;
    const pose = poseOf({ position: center, rotation_wxyz: [Math.cos(half), 0, 0, Math.sin(half)] });
    this.own.add(selection({ box: { size, pose: pose.transpose().elements } }));
    if (!draft.row.points) return;
    fetch(draft.row.points.slice(1)).then((answer) => (answer.ok ? answer.arrayBuffer() : Promise.reject(new Error("its points are not there")))).then((data) => {
      if (draft !== this.draft) return;
      const geometry = new PLYLoader().parse(data);
      this.own.add(new Points(geometry, new PointsMaterial({ size: OWN_POINT_M, color: OWN_COLOR, depthTest: false, transparent: true, opacity: 0.7 })));
      this.canvas.draw();
    }).catch((error) => draft === this.draft && this.on.say(`${draft.row.category}: ${error.message}`, true));
  }

  /** Where a point of the world lies on the page [px]. */
  project(point) {
    return this.canvas.project(new Vector3(...point));
  }
}

/** From which side a photo was taken, a little from above at least. */
function fromPhoto(camera) {
  const direction = away(camera);
  return direction.setZ(Math.max(direction.z, LEAST_SLOPE));
}

/** From what a photo's camera looks at to the camera, unit. */
const away = ({ position, target }) => new Vector3(...position).sub(new Vector3(...target)).normalize();

const idOf = (draft) => draft.row.instance_id;

/** The name of the blob at an address of the server. */
const nameOf = (address) => decodeURIComponent(address.split("/").pop());

/** What stands for an object that somebody else answers for: selection's best, as the figures take it; else what the lake placed. */
function standing(row) {
  const best = row.candidates.find((offer) => offer.rank === 1 && offer.blob && offer.pose);
  if (!best) return row.placed;
  return { blob: best.blob, scale: best.scale, poses: { proposed: best.pose, optimized: best.pose, settled: best.pose } };
}

function scanned({ center, size }) {
  const reach = Math.hypot(size[0], size[1]) / 2;
  return new Box3(
    new Vector3(center[0] - reach, center[1] - reach, center[2] - size[2] / 2),
    new Vector3(center[0] + reach, center[1] + reach, center[2] + size[2] / 2),
  );
}
