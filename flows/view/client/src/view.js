// The viewer: one scene at a time, from the lake or from the page itself.

import { Group, Vector3 } from "three";
import { Canvas } from "./canvas.js";
import { make } from "./dom.js";
import { Drive } from "./drives.js";
import { Walk } from "./episodes.js";
import { Frames } from "./frames.js";
import { keys } from "./keys.js";
import { layout } from "./layout.js";
import { Colliders, navmesh, problems, SELECTED, selection, supports } from "./marks.js";
import { forget, release } from "./models.js";
import { driveList, objectFacts, objectTree, sceneFacts, sceneList, walkList } from "./panels.js";
import { Player } from "./player.js";
import { Replica } from "./replica.js";
import { roomBox, Scan, shellOf } from "./room.js";
import { pathOf, source } from "./source.js";

const SETTLE_SECONDS = 4;

class View {
  constructor(page) {
    this.on = { problems: true };
    this.nodes = layout(page, {
      layer: (name, on) => this.layer(name, on),
      cut: (share) => this.cut(share),
      time: (moment) => this.settle.set(moment),
      play: () => this.play(this.settle),
      tab: (name) => this.tab(name),
      camera: (how) => this.look(how),
    });
    this.canvas = new Canvas(this.nodes.view);
    this.canvas.onPointer((x, y) => this.select(this.idAt(x, y)), (x, y) => this.hover(x, y));
    this.canvas.paper(getComputedStyle(document.documentElement).getPropertyValue("--view").trim() || "#eef1f5");
    this.settle = new Player(2, SETTLE_SECONDS, (moment) => this.#at(moment), () => this.#at(this.settle.now));
    this.selected = null;
    this.loading = this.refreshing = 0;
    keys(this);
    addEventListener("hashchange", () => this.#follow());
    this.cut(0.45);
  }

  /** Show the scenes of the lake, and of them the one that the address names, or the first. */
  async start() {
    this.listing = await source.json("scenes");
    const { lake, snapshot, release, scenes } = this.listing;
    this.nodes.where.textContent = `${release ? `release ${release}, ` : ""}snapshot ${snapshot}`;
    this.nodes.where.title = lake;
    this.nodes.scenes.append(make("h2", { textContent: `Scenes (${scenes.length})` }), sceneList(this.listing, (id) => this.open(id)));
    await this.#follow();
  }

  async #follow() {
    const [dataset, scan, instance] = decodeURIComponent(location.hash.slice(1)).split("/");
    const wanted = scan ? `${dataset}/${scan}` : null;
    const known = this.listing.scenes.some((row) => row.id === wanted);
    if (this.document?.id !== wanted || !known) await this.open(known ? wanted : (this.document?.id ?? this.listing.first));
    if (known && instance && this.selected !== instance) this.select(instance);
  }

  /** Show a scene. */
  async open(id) {
    if (this.document?.id === id) return;
    const turn = (this.loading += 1);
    this.#say(`Loading ${id} …`);
    this.settle.pause();
    try {
      const told = await source.json(pathOf(id));
      if (turn !== this.loading) return;
      this.#clear(told);
      for (const button of this.nodes.scenes.querySelectorAll("[data-scene]")) {
        button.setAttribute("aria-current", String(button.dataset.scene === id));
        if (button.dataset.scene === id) button.scrollIntoView({ block: "nearest" });
      }
      await this.#load(turn, told);
    } catch (error) {
      if (turn === this.loading) this.#say(error.message, true);
    }
  }

  #clear(told) {
    forget();
    this.canvas.facing = [];
    const { scan, replica, marks } = this.canvas;
    for (const group of [this.scanGroup, this.shell, this.objects, this.layers, this.over]) release(group?.removeFromParent());
    for (const made of Object.values(this.made ?? {})) made.then((parts) => [parts].flat().forEach((part) => release(part.group ?? part)), () => {});
    [this.scanGroup, this.objects, this.layers, this.over] = [new Group(), new Group(), new Group(), new Group()];
    scan.add(this.scanGroup);
    replica.add(this.objects, this.layers);
    marks.add(this.over);
    Object.assign(this, { document: told, selected: null, scan: null, shell: null, made: {}, marksOn: {} });
    this.replica = new Replica(told, this.objects);
    this.stopWalk();
    this.nodes.objects.replaceChildren(make("h2", { textContent: `Objects (${told.objects.length})` }), objectTree(told, (id) => this.select(id, true)));
    this.frames = new Frames(this.nodes.panes.frames, told, (id) => this.select(id));
    this.#walks(null);
    this.nodes.panes.object.replaceChildren(...sceneFacts(told, (id) => this.select(id, true)));
    history.replaceState(null, "", `#${told.id}`);
    this.nodes.time.value = this.settle.now = 1;
    this.#playing();
  }

  async #load(turn, told) {
    const count = told.objects.filter((row) => row.placed).length;
    let done = 0;
    const begun = performance.now();
    const room = shellOf(told).then(({ shell, facing }) => {
      if (turn !== this.loading) return;
      this.shell = shell;
      this.canvas.replica.add(shell);
      this.canvas.facing = facing;
      this.canvas.draw();
    });
    const objects = this.replica.load(() => turn === this.loading && this.#say(`${(done += 1)} of ${count} objects`));
    const scanning = Scan.of(told, this.scanGroup);
    scanning.catch(() => {}); // told of below
    this.look("corner");
    const [failed] = await Promise.all([objects, room]);
    if (turn !== this.loading) return;
    this.canvas.facing.push(...this.#hung());
    this.look("corner");
    await this.#refresh();
    this.seconds = { replica: (performance.now() - begun) / 1000 };
    const scan = await scanning;
    if (turn !== this.loading) return;
    this.scan = scan;
    this.scan.asPoints(this.on.points ?? false);
    if (!told.objects.length) this.look("corner");
    this.canvas.quick = (wanted, isSlow) => this.scan?.quick(wanted, isSlow);
    this.canvas.measure();
    this.seconds.all = (performance.now() - begun) / 1000;
    this.#say(failed.length ? `Cannot be drawn: ${failed.join("; ")}` : "", failed.length > 0);
    if (this.frames.isOpen && !this.nodes.panes.frames.hidden) this.frames.open();
    document.documentElement.dataset.ready = told.id;
  }

  /** What hangs on walls goes with them, unless it is selected. */
  #hung() {
    const sides = new Map(this.canvas.facing.map((each) => [each.wall, each]));
    const rows = this.document.objects.filter((row) => row.support?.relation === "wall" && sides.has(row.support.against));
    return rows.filter((row) => this.replica.shown.has(row.id)).map((row) => {
      const { point, normal } = sides.get(row.support.against);
      const objects = () => [this.replica.shown.get(row.id), this.colliders?.holders.get(row.id)].filter(Boolean);
      return { objects, point, normal, stays: () => this.selected === row.id };
    });
  }

  #say(text, isWrong = false) {
    this.nodes.status.textContent = text;
    this.nodes.status.hidden = !text;
    this.nodes.status.classList.toggle("wrong", isWrong);
    if (text && !isWrong) delete document.documentElement.dataset.ready;
  }

  /** Where the camera stands: `corner`, `above`, or `object` for the one that is selected. */
  look(how) {
    if (how === "object" && this.selected) {
      const box = this.replica.box(this.selected);
      this.canvas.look(box.expandByScalar(Math.max(0.15, box.getSize(new Vector3()).length() * 0.25)));
      return;
    }
    const room = this.document.room;
    const box = room ? roomBox(room) : this.replica.bounds;
    if (box.isEmpty() && this.scan) box.setFromObject(this.scan.group);
    if (box.isEmpty()) return;
    const boxes = this.document.objects.map((row) => this.replica.box(row.id));
    this.canvas.look(box, how === "above" ? new Vector3(0, -0.02, 1) : this.canvas.direction(box, boxes));
  }

  /** Share of the picture that shows the scan. */
  cut(share) {
    this.canvas.cut = share;
    this.nodes.cut.value = Math.round(share * 100);
    this.nodes.view.style.setProperty("--cut", `${share * 100}%`);
    this.nodes.ends[0].hidden = share < 0.08;
    this.nodes.ends[1].hidden = share > 0.92;
    this.canvas.draw();
  }

  #at(moment) {
    this.nodes.time.value = moment;
    this.replica?.at(moment);
    this.#playing();
    return this.#refresh();
  }

  #playing() {
    const runs = this.settle.isRunning;
    this.canvas.isPlaying = runs || (this.walking?.isRunning ?? false);
    this.nodes.play.textContent = runs ? "⏸" : "▶";
    this.nodes.play.setAttribute("aria-label", runs ? "Pause" : "Play how it settles");
    for (const stop of this.nodes.stops) stop.setAttribute("aria-pressed", String(Number(stop.dataset.time) === Number(this.nodes.time.value)));
  }

  /** Play or pause. */
  play(player) {
    if (player.isRunning) player.pause();
    else player.play();
    this.#playing();
  }

  /** Show or hide a layer. */
  layer(name, on) {
    this.on[name] = on;
    if (name === "points") this.scan?.asPoints(on);
    return this.#refresh().catch((error) => this.#say(error.message, true));
  }

  /** What a layer shows, made once; what could not be made is tried again the next time. */
  #make(name, begin) {
    const made = this.made;
    made[name] ??= begin().catch((error) => {
      delete made[name];
      throw error;
    });
    return made[name];
  }

  /** Draw marks and layers anew. */
  async #refresh() {
    const told = this.document;
    if (!told) return;
    const time = this.settle.now;
    const turn = (this.refreshing += 1);
    const [colliders, floors] = await Promise.all([
      this.on.colliders && this.#make("colliders", () => new Colliders(told).load()),
      this.on.navmesh && this.#make("navmesh", () => Promise.all(told.navmeshes.slice(0, 1).map(navmesh))),
    ]);
    if (told !== this.document || turn !== this.refreshing) return;
    this.colliders = colliders || null;
    this.colliders?.at(time);
    this.objects.visible = !colliders;
    this.layers.clear();
    if (colliders) this.layers.add(colliders.group);
    for (const floor of floors || []) this.layers.add(floor);
    if (this.walk) this.layers.add(this.walk.body);
    release(this.over);
    this.over.clear();
    if (this.on.problems) this.over.add(problems(told, this.replica, time));
    if (this.on.supports) this.over.add(supports(told, this.replica));
    if (this.walk) this.over.add(this.walk.marks);
    if (this.selected) this.over.add(selection(this.replica.rows.get(this.selected)));
    if (colliders && colliders.missing) this.#say(`${colliders.missing} objects have no collider in the lake: colliders come from the Habitat export`);
    else if (this.on.navmesh && !told.navmeshes.length) this.#say("the lake has no navmesh of this scene");
    else if (document.documentElement.dataset.ready) this.nodes.status.hidden = true;
    this.canvas.draw();
  }

  /** The object under a place of the canvas [px]. */
  idAt(x, y) {
    if (!this.replica) return null;
    const hit = this.canvas.pick(x, y, [...this.replica.shown.values()].filter((holder) => holder.visible));
    return hit ? this.replica.idOf(hit.object) : null;
  }

  hover(x, y) {
    const id = x === null ? null : this.idAt(x, y);
    const row = id && this.replica.rows.get(id);
    this.nodes.label.hidden = !row;
    this.canvas.node.classList.toggle("over", Boolean(row));
    if (!row) return;
    this.nodes.label.textContent = `${row.category} ${row.id}`;
    this.nodes.label.style.transform = `translate(${x + 14}px, ${y + 10}px)`;
  }

  /** Select an object, or nothing; `isListed`: from a list, so that the camera may have to look for it. */
  select(id, isListed = false) {
    const row = id ? this.replica.rows.get(id) : null;
    this.selected = row ? id : null;
    this.replica.tint(this.selected, SELECTED);
    for (const button of this.nodes.objects.querySelectorAll("[data-instance]")) {
      button.setAttribute("aria-current", String(button.dataset.instance === this.selected));
      if (button.dataset.instance === this.selected && !isListed) button.scrollIntoView({ block: "nearest" });
    }
    this.#facts();
    this.frames.select(row);
    this.#walks(row);
    if (!this.nodes.panes.frames.hidden) this.frames.open();
    history.replaceState(null, "", `#${this.document.id}${row ? `/${id}` : ""}`);
    return this.#refresh();
  }

  #facts() {
    const pane = this.nodes.panes.object;
    const row = this.selected && this.replica.rows.get(this.selected);
    const facts = row
      ? objectFacts(this.document, row, this.replica.tried.get(row.id), (offer) => this.attempt(offer))
      : sceneFacts(this.document, (id) => this.select(id, true));
    pane.replaceChildren(...facts);
    pane.scrollTop = 0;
  }

  /** Show a candidate in place of the selected object; null or what is shown: what was placed. */
  async attempt(offer) {
    const id = this.selected;
    if (!id || (offer && !(offer.blob && offer.pose))) return;
    const replica = this.replica;
    if (!(await replica.try(id, offer)) || replica !== this.replica) return;
    this.replica.tint(this.selected, SELECTED);
    const pane = this.nodes.panes.object;
    for (const tile of id === this.selected ? pane.querySelectorAll("[data-slot]") : []) {
      const shown = offer ? String(offer.slot) : tile.classList.contains("placed") ? tile.dataset.slot : "";
      tile.setAttribute("aria-pressed", String(tile.dataset.slot === shown));
    }
    const back = pane.querySelector(".tiles + .link");
    if (back && id === this.selected) back.hidden = offer === null;
    await this.#refresh();
  }

  /** The object before or after the selected one in the list. */
  step(by) {
    const ids = [...this.nodes.objects.querySelectorAll("[data-instance]")].map((button) => button.dataset.instance);
    const at = ids.indexOf(this.selected);
    if (ids.length) this.select(ids[(at + by + ids.length + (at < 0 && by < 0 ? 1 : 0)) % ids.length]);
  }

  /** The scene before or after this one in the list. */
  stepScene(by) {
    const ids = this.listing.scenes.map((row) => row.id);
    const next = ids[ids.indexOf(this.document.id) + by];
    if (next) this.open(next);
  }

  /** Show a tab of the right side. */
  tab(name) {
    for (const [each, pane] of Object.entries(this.nodes.panes)) pane.hidden = each !== name;
    for (const [each, tab] of Object.entries(this.nodes.tabs)) tab.setAttribute("aria-selected", String(each === name));
    if (name === "frames") this.frames.open();
  }

  /** Fill the list of episodes: of the selected object where there are any, else of all. */
  #walks(row) {
    const walks = walkList(this.document, row, (episode) => this.startWalk(new Walk(episode, this.document.navmeshes)));
    this.nodes.panes.walks.replaceChildren(...walks, ...driveList(this.document, row, (run) => this.startWalk(new Drive(run))));
  }

  /** Play an episode, or the run of a cart. */
  startWalk(walk) {
    this.stopWalk();
    this.walk = walk;
    this.walking = new Player(walk.end, walk.seconds, (moment) => {
      this.walk.at(moment);
      this.#playing();
      this.canvas.draw();
    }, () => {
      this.#playing();
      this.canvas.draw();
    });
    this.walk.at(0);
    this.canvas.agent = this.walk.camera;
    this.canvas.beforeInset = (inside) => {
      if (this.walk) this.walk.body.visible = !inside;
    };
    this.nodes.inset.hidden = false;
    for (const button of this.nodes.panes.walks.querySelectorAll("[data-episode], [data-drive]")) {
      button.setAttribute("aria-current", String(Object.entries(walk.name).every(([kind, id]) => button.dataset[kind] === id)));
    }
    this.#refresh();
    this.walking.play();
  }

  /** Take the agent away. */
  stopWalk() {
    this.walking?.pause();
    release(this.walk?.body);
    this.walk = this.walking = null;
    this.canvas.agent = null;
    this.nodes.inset.hidden = true;
    for (const button of this.nodes.panes.walks.querySelectorAll("[aria-current=true]")) button.setAttribute("aria-current", "false");
  }

  /** What tests and curious people may ask. */
  get state() {
    return {
      scene: this.document?.id ?? null, selected: this.selected, objects: this.replica?.shown.size ?? 0, points: this.scan?.count ?? 0,
      time: this.settle.now, cut: this.canvas.cut, tried: Object.fromEntries(this.replica?.tried ?? []), drawings: this.canvas.frames,
      walk: this.walk ? { ...this.walk.name, moment: this.walking.now, end: this.walk.end } : null, seconds: this.seconds,
      layers: this.layers?.children.length ?? 0, calls: this.canvas.renderer.info.render.calls,
    };
  }

  /** Where the middle of an object lies on the page [px]. */
  placeOf(id) {
    return this.canvas.project(this.replica.box(id).getCenter(new Vector3()));
  }

  /** Where an object is shown in the world [m]. */
  positionOf(id) {
    return new Vector3().setFromMatrixPosition(this.replica.shown.get(id).matrix).toArray();
  }
}

const page = document.getElementById("page");
try {
  window.view = new View(page);
  window.view.start().catch((error) => window.view.nodes.status.replaceChildren(error.message));
} catch (error) {
  page.replaceChildren(make("p", { class: "away", textContent: `This page cannot be drawn here: ${error.message}. It needs WebGL.` }));
}
