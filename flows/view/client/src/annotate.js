// The page of an annotation batch: its objects one by one are chosen for, aligned and ranked, or their answers reviewed.

import { Draft } from "./annotating/draft.js";
import { Editing } from "./annotating/editing.js";
import { Fields } from "./annotating/fields.js";
import { figureTable } from "./annotating/figures.js";
import { Handing } from "./annotating/handing.js";
import { listen } from "./annotating/keys.js";
import { entry, entryKey, isListed, progressParts } from "./annotating/listing.js";
import { pageOf, press } from "./annotating/page.js";
import { about, actions, asideText, verdictBox } from "./annotating/panel.js";
import { Saving } from "./annotating/saving.js";
import { ask, keyPath } from "./annotating/server.js";
import { SCAN_MODES, Stage } from "./annotating/stage.js";
import { tray } from "./annotating/tray.js";
import { make } from "./dom.js";

const FIGURES_MS = 250;
const IDLE_S = 60; // after so long without a hand on it, time does not count
const HINTS = {
  choose: "Which looks most like the object? Category, then shape and size, then color.",
  align: "On the scanned points, standing on what carries it, in nothing else.",
  rank: "The next best, 2nd to 5th.",
};

class Annotate {
  constructor(page) {
    this.nodes = pageOf(page, {
      search: () => this.list(), scanMode: (mode) => this.scanMode(mode), handles: (mode) => this.handles(mode), look: (how) => this.stage.look(how),
      undo: () => this.editing.undo(), redo: () => this.editing.redo(), step: (name) => this.turnTo(name), cut: (share) => this.stage.cut(share),
    });
    this.stage = new Stage(this.nodes.view, {
      moved: (transform) => this.editing.dragged(transform), moveDone: () => this.editing.dropped(), picked: (id) => this.#picked(id), turned: () => this.#aside(),
      say: (text, isWrong) => this.say(text, isWrong),
    });
    this.saving = new Saving((state, reason) => this.#saved(state, reason));
    this.fields = new Fields({
      change: (transform) => this.editing.place(transform), support: (transform) => this.stage.support(this.draft, transform),
      snap: (isOn) => (this.editing.snaps = isOn), putDown: (where) => this.editing.putDown(where), settle: () => this.editing.settle(),
      reset: () => this.editing.reset(),
    });
    Object.assign(this, { entries: [], current: null, stepName: "choose", handle: "translate", isReviewing: false, touched: 0, figureTurn: 0 });
    this.editing = new Editing(this);
    this.handing = new Handing(this);
    listen(this);
    this.#saved("saved", "");
    this.scanMode("over");
    for (const kind of ["pointerdown", "keydown", "wheel"]) addEventListener(kind, () => (this.touched = performance.now()), { passive: true });
    setInterval(() => this.#tick(), 1000);
    addEventListener("hashchange", () => this.#follow());
  }

  /** Ask who this is and what is to be done. */
  async start() {
    this.me = await ask("GET", "me");
    const { roles, batch, person } = this.me;
    this.nodes.where.textContent = `${person}, ${batch.batch_id}`;
    document.title = `${batch.batch_id}: annotation`;
    this.nodes.roles.hidden = roles.length < 2;
    const tabs = [["annotator", "Annotate"], ["reviewer", "Review"]].map(([role, text]) =>
      make("button", { type: "button", role: "tab", textContent: text, "aria-selected": "false", "data-role": role, onclick: () => this.open(role === "reviewer") }));
    this.nodes.roles.replaceChildren(...tabs);
    const isReview = !roles.includes("annotator") || (roles.includes("reviewer") && batch.state === "in_review");
    await this.open(isReview);
  }

  /** Show what is to be annotated, or to be reviewed. */
  async open(isReview) {
    this.isReviewing = isReview;
    for (const tab of this.nodes.roles.children) tab.setAttribute("aria-selected", String((tab.dataset.role === "reviewer") === isReview));
    this.nodes.stepBar.hidden = this.nodes.handleBar.hidden = this.nodes.undo.hidden = this.nodes.redo.hidden = isReview;
    await this.saving.flush();
    const [told] = await Promise.all([ask("GET", isReview ? "reviews" : "work"), this.progress()]);
    this.entries = isReview ? told.answers.map((row) => ({ row, draft: new Draft({ ...row, draft: null }) })) : told.objects.map((row) => this.#entry(row));
    this.current = null;
    this.list();
    if (!this.entries.length) {
      this.say(isReview ? "Nothing is to be judged now." : "Nothing is asked of you in this batch.");
      this.nodes.pane.replaceChildren();
      this.nodes.tray.replaceChildren();
      document.documentElement.dataset.ready = "none";
      return;
    }
    const isDone = ({ row }) => (isReview ? row.verdict : row.status === "answered");
    const first = this.entries.find((each) => !isDone(each)) ?? this.entries.find(({ row }) => row.remarks?.length) ?? this.entries[0];
    if (!(await this.#follow())) await this.select(first.draft);
  }

  /** An object with what is decided for it: what the server does not have yet stays. */
  #entry(row) {
    const held = this.saving.held(row.key);
    if (!held) return { row, draft: new Draft(row) };
    held.row = row;
    row.status = "draft";
    return { row, draft: held };
  }

  async #follow() {
    const wanted = decodeURIComponent(location.hash.slice(1));
    const named = this.entries.find(({ row }) => entryKey(row) === wanted);
    if (named && named !== this.current) await this.select(named.draft);
    return Boolean(named);
  }

  get draft() {
    return this.current?.draft ?? null;
  }

  /** Whether the current object may be changed. */
  get isOpen() {
    return Boolean(this.current && !this.isReviewing && this.current.row.is_open);
  }

  /** Show an object of the list. */
  async select(draft) {
    this.typed();
    this.editing.dropped();
    this.saving.flush();
    this.current = this.entries.find((each) => each.draft === draft) ?? null;
    if (!this.current) return;
    const { row } = this.current;
    delete document.documentElement.dataset.shown;
    history.replaceState(null, "", `#${encodeURIComponent(entryKey(row)).replaceAll("%2F", "/")}`);
    this.figures = row.figures ?? null;
    this.fields.support = 0;
    this.turnTo("choose");
    this.#mark();
    this.#pane();
    this.fields.show(draft.transform, this.isOpen, true); // nobody types over the numbers of the object before
    const room = `${row.scene_id} ${row.annotator ?? ""}`;
    try {
      if (this.room !== room || this.stage.scene !== row.scene_id) await this.#openRoom(room, row);
      else {
        await this.stage.show(draft);
        if (draft === this.draft) this.stage.look("object");
      }
    } catch (error) {
      this.room = null;
      this.stage.canvas.isHeld = false;
      this.say(error.message, true);
    }
    if (draft !== this.draft) return;
    if (draft.lost) this.say(draft.lost, true);
    this.#show();
    this.measure();
    document.documentElement.dataset.shown = entryKey(row);
  }

  async #openRoom(room, { scene_id: scene, instance_id: first, annotator }) {
    this.room = room;
    const own = this.entries.filter(({ row }) => row.scene_id === scene && row.annotator === annotator);
    await this.stage.open(scene, new Map(own.map(({ row, draft }) => [row.instance_id, draft])), first);
  }

  /** The list, by what is searched for. */
  list() {
    const [wanted, onlyOpen] = [this.nodes.search.value.trim(), this.nodes.onlyOpen.getAttribute("aria-pressed") === "true"];
    const shown = this.entries.filter(({ row }) => isListed(row, wanted, onlyOpen));
    this.nodes.list.replaceChildren(...shown.map((each) => entry(each, (draft) => this.select(draft))));
    this.#mark();
  }

  #mark() {
    for (const button of this.nodes.list.querySelectorAll("[data-key]")) {
      const isCurrent = button.dataset.key === (this.current && entryKey(this.current.row));
      button.setAttribute("aria-current", String(isCurrent));
      if (isCurrent) button.scrollIntoView({ block: "nearest" });
    }
  }

  /** The object before or after this one in the list. */
  step(by) {
    const keys = [...this.nodes.list.querySelectorAll("[data-key]")].map((button) => button.dataset.key);
    const at = keys.indexOf(this.current && entryKey(this.current.row));
    if (!keys.length) return;
    const key = keys[(at + by + keys.length + (at < 0 && by < 0 ? 1 : 0)) % keys.length];
    this.select(this.entries.find(({ row }) => entryKey(row) === key).draft);
  }

  /** The next object that nobody answered for, or answer that nobody judged; whether there is one. */
  nextOpen() {
    const at = this.entries.indexOf(this.current);
    const later = [...this.entries.slice(at + 1), ...this.entries.slice(0, Math.max(0, at))];
    const next = later.find(({ row }) => (this.isReviewing ? !row.verdict : !["answered", "saving"].includes(row.status)));
    if (next) this.select(next.draft);
    return Boolean(next);
  }

  /** Go to a step: choose, align, rank. */
  turnTo(name) {
    this.stepName = name;
    this.typed(); // numbers are candidates again
    for (const [each, tab] of Object.entries(this.nodes.steps)) tab.setAttribute("aria-selected", String(each === name));
    this.nodes.hint.textContent = HINTS[name];
    this.handles(name === "align" ? this.handle : null);
    this.#tray();
  }

  /** Take over a number that is being typed: it is of the object that is shown. */
  typed() {
    if (document.activeElement?.type === "number") document.activeElement.blur();
  }

  /** Show handles of a kind, and with them the step of aligning; null: none. */
  handles(mode) {
    if (mode && this.isReviewing) return;
    if (mode) this.handle = mode;
    if (mode && this.stepName !== "align") {
      this.turnTo("align");
      return;
    }
    press(this.nodes.handles, mode);
    this.stage.handles(Boolean(mode) && this.isOpen, mode);
  }

  scanMode(mode) {
    this.stage.scanGroup && this.stage.scanMode(mode);
    this.stage.mode = mode;
    press(this.nodes.scans, mode);
    this.nodes.edge.hidden = mode !== "beside";
  }

  nextScanMode() {
    this.scanMode(SCAN_MODES[(SCAN_MODES.indexOf(this.stage.mode) + 1) % SCAN_MODES.length]);
  }

  /** The current draft is another one than before. */
  changed() {
    const { row } = this.current;
    if (row.status !== "draft") {
      row.status = "draft";
      this.refresh(this.current);
    }
    this.saving.put(this.draft);
    this.redraw();
  }

  /** Draw what is decided for the current object. */
  redraw() {
    this.stage.follow();
    this.#show();
    this.measure();
  }

  #picked(id) {
    const near = this.entries.find(({ row }) => row.scene_id === this.stage.scene && row.instance_id === id && row.annotator === this.current?.row.annotator);
    if (near && near !== this.current) this.select(near.draft);
    else if (!near) this.say(`${id} is not asked here`);
  }

  /** Ask for the figures of the draft as it is, soon. */
  measure() {
    clearTimeout(this.measuring);
    this.figuring?.abort(); // nobody waits for the figures of before
    const ending = (this.figuring = new AbortController());
    const { draft } = this;
    if (!draft || this.isReviewing) return;
    const turn = (this.figureTurn += 1);
    if (!draft.chosen) {
      this.#figures(null, "Nothing is chosen.");
      return;
    }
    this.measuring = setTimeout(async () => {
      try {
        const figures = await ask("POST", `figures/${keyPath(draft.key)}`, draft.body, ending.signal);
        if (turn === this.figureTurn && draft === this.draft) this.#figures(figures);
      } catch (error) {
        if (turn === this.figureTurn && draft === this.draft) this.#figures(null, error.message);
      }
    }, FIGURES_MS);
  }

  #figures(figures, text = "") {
    this.figures = figures;
    this.nodes.figures?.replaceChildren(figureTable(figures, text));
  }

  /** Everything that shows the current draft: tray, fields, what can be undone. */
  #show() {
    const { draft } = this;
    if (!draft) return;
    this.#tray();
    this.fields.show(draft.transform, this.isOpen);
    this.nodes.undo.disabled = !this.isOpen || !draft.canUndo;
    this.nodes.redo.disabled = !this.isOpen || !draft.canRedo;
  }

  #tray() {
    if (!this.draft) return;
    const { editing } = this;
    const pick = (slot) => (this.stepName === "rank" ? editing.rank(slot) : editing.choose(slot));
    const on = this.isOpen ? { pick, rank: (slot, place) => editing.rank(slot, place), none: () => editing.choose(null) } : null;
    const focused = document.activeElement?.closest?.(".tray [data-slot]")?.dataset.slot;
    this.nodes.tray.replaceChildren(...tray(this.draft, this.isReviewing ? "rank" : this.stepName, on));
    if (focused) this.nodes.tray.querySelector(`[data-slot="${focused}"]`)?.focus();
  }

  /** The right side, made anew for another object. */
  #pane() {
    const { row } = this.current;
    this.nodes.figures = make("div", {}, figureTable(this.figures, this.isReviewing ? "It has no figures." : ""));
    const parts = about(row);
    [this.nodes.aside, this.nodes.shot] = [parts[0].querySelector("figcaption"), parts[0].querySelector("img")];
    this.verdict = this.isReviewing ? verdictBox(row, this.me.batch.state === "in_review", { judge: (passes) => this.handing.judge(passes) }) : null;
    this.nodes.acts = make("div");
    parts[0].append(this.nodes.photoCamera);
    this.nodes.pane.replaceChildren(...parts, this.verdict ?? this.nodes.acts, this.nodes.figures, this.fields.node);
    this.nodes.photoCamera.hidden = !row.photos.length;
    this.#handing();
    this.#aside();
  }

  /** What is to be done with the current object, by its status. */
  #handing() {
    const { row } = this.current;
    const { handing } = this;
    if (this.verdict) {
      this.verdict.press(row);
      return;
    }
    const acts = actions(row, { save: () => handing.save(), nextOpen: () => this.nextOpen(), withdraw: () => handing.withdraw(), back: () => handing.back() });
    this.nodes.acts.replaceWith(acts);
    this.nodes.acts = acts;
  }

  /** What shows the status of an entry of the list, after it has changed. No field is made anew: somebody may be typing in it. */
  refresh(changed) {
    this.list();
    if (changed === this.current) this.#handing();
  }

  /** The photo that looks as the view does, and how far the view is turned from it. */
  #aside() {
    const { nodes: { shot }, stage } = this;
    const source = stage?.draft?.row === this.current?.row ? stage?.photo?.photo.slice(1) : null;
    if (shot && source && shot.getAttribute("src") !== source) Object.assign(shot, { src: source, onerror: () => stage.losePhoto() });
    const text = asideText(this.stage?.aside ?? null);
    if (this.nodes.aside && text && this.nodes.aside.textContent !== text) this.nodes.aside.textContent = text;
  }

  /** Ask how far everybody is. */
  async progress() {
    try {
      const told = await ask("GET", "progress");
      Object.assign(this.me.batch, told.batch);
      const mine = (role) => this.me.roles.includes(role) && this.isReviewing === (role === "reviewer");
      const { handing } = this;
      this.nodes.progress.replaceChildren(...progressParts(told, {
        submit: mine("annotator") && (() => handing.submit()), sample: mine("reviewer") && (() => handing.sample()),
        conclude: mine("reviewer") && (() => handing.conclude()),
      }));
    } catch (error) {
      this.say(error.message, true);
    }
  }

  /** Say something over the scene; nothing: be still. */
  say(text, isWrong = false) {
    this.nodes.status.textContent = text;
    this.nodes.status.hidden = !text;
    this.nodes.status.classList.toggle("wrong", isWrong);
  }

  #saved(state, reason) {
    const text = { saved: "Saved", saving: "Saving …", unsaved: `Not saved: ${reason}` }[state];
    this.nodes.saved.textContent = text;
    this.nodes.saved.dataset.state = state;
  }

  #tick() {
    const isThere = document.visibilityState === "visible" && performance.now() - this.touched < IDLE_S * 1000;
    if (isThere && this.isOpen) this.draft.seconds += 1;
  }

  /** What tests and curious people may ask. */
  get state() {
    const { draft, stage } = this;
    return {
      key: this.current && entryKey(this.current.row), step: this.stepName, now: draft?.now ?? null, transform: draft?.transform ?? null,
      status: this.current?.row.status ?? null, saved: this.saving.state, figures: this.figures, drawings: stage.canvas.frames, mode: stage.mode,
      scene: stage.scene, points: stage.scan?.count ?? 0, objects: stage.replica?.shown.size ?? 0, reviewing: this.isReviewing,
      listed: this.entries.map(({ row }) => [entryKey(row), row.status ?? null]),
    };
  }
}

const place = document.getElementById("page");
try {
  window.annotate = new Annotate(place);
  window.annotate.start().catch((error) => window.annotate.say(error.message, true));
} catch (error) {
  place.replaceChildren(make("p", { class: "away", textContent: `This page cannot be drawn here: ${error.message}. It needs WebGL.` }));
}
