// Every change goes to the server by itself; what it has not confirmed is sent again until it has.

import { Absence, ask, keyPath, Refusal } from "./server.js";

const PAGE = crypto.getRandomValues(new Uint32Array(4)).join("-"); // tells windows apart: edits are counted in each
const SOON_MS = 150;
const AGAIN_MS = [500, 1000, 2000, 4000];

const edits = new Map(); // key -> how often something of it was sent: as long as the page is open, whatever it shows meanwhile

/** The number of the next edit of an object, so that what comes late does not win. */
export function counted(key) {
  edits.set(key, (edits.get(key) ?? 0) + 1);
  return { edit: edits.get(key), page: PAGE };
}

/** What the server is sent of a draft. */
export const numbered = (draft) => ({ ...draft.body, ...counted(draft.key) });

export class Saving {
  /** `changed` is told "saved", "saving" or "unsaved", and why it is not. */
  constructor(changed) {
    // refused: key -> draft and why the server does not take it; called unsaved until it is changed, or taken in another way
    Object.assign(this, { changed, pending: new Map(), refused: new Map(), running: null, timer: 0, failures: 0, state: "saved", reason: "" });
    addEventListener("online", () => this.flush());
    addEventListener("beforeunload", (event) => {
      if (this.state !== "saved") event.preventDefault();
    });
  }

  /** A draft has changed. */
  put(draft) {
    this.pending.set(draft.key, draft);
    this.refused.delete(draft.key);
    if (!this.failures) this.#tell();
    if (!this.timer && !this.failures) this.timer = setTimeout(() => this.flush(), SOON_MS);
  }

  /** Send at once what waits. Resolves when it was sent, or could not be. */
  async flush() {
    clearTimeout(this.timer);
    this.timer = 0;
    this.running ??= this.#send().finally(() => {
      this.running = null;
      if (this.pending.size && !this.timer) this.timer = setTimeout(() => this.flush(), this.failures ? this.#pause() : 0);
    });
    return this.running;
  }

  /** A draft was handed in as an answer, or thrown away: none of it waits any more. */
  release(draft) {
    this.refused.delete(draft.key);
    this.pending.delete(draft.key);
    if (!this.failures && !this.running) this.#tell();
  }

  /** The draft of an object that the server does not have as it is here; null where it has. */
  held(key) {
    return this.pending.get(key) ?? this.refused.get(key)?.draft ?? null;
  }

  #pause() {
    return AGAIN_MS[Math.min(this.failures, AGAIN_MS.length) - 1];
  }

  async #send() {
    for (const [key, draft] of [...this.pending]) {
      const { version } = draft;
      try {
        await this.#put(draft);
        this.failures = 0;
        if (draft.version === version && this.pending.get(key) === draft) this.pending.delete(key);
      } catch (error) {
        if (error instanceof Absence) {
          this.failures += 1;
          this.#set("unsaved", error.message);
          return;
        }
        if (!(error instanceof Refusal)) throw error;
        this.failures = 0;
        if (draft.version !== version || this.pending.get(key) !== draft) continue; // as it is now it was not sent yet
        this.pending.delete(key); // the server will not take it, however often it is sent
        this.refused.set(key, { draft, reason: `${draft.row.category} ${draft.row.instance_id}: ${error.message}` });
      }
    }
    this.#tell();
  }

  async #put(draft) {
    const path = `drafts/${keyPath(draft.key)}`;
    try {
      await ask("PUT", path, numbered(draft));
    } catch (error) {
      const known = error instanceof Refusal && error.status === 409 ? (error.value.edit ?? error.value.draft?.edit) : null;
      if (!Number.isInteger(known)) throw error;
      edits.set(draft.key, Math.max(known, edits.get(draft.key))); // an edit that was thought lost had arrived
      await ask("PUT", path, numbered(draft));
    }
  }

  #tell() {
    const [first] = this.refused.values();
    if (first) this.#set("unsaved", first.reason);
    else this.#set(this.pending.size ? "saving" : "saved");
  }

  #set(state, reason = "") {
    if (state === this.state && reason === this.reason) return;
    Object.assign(this, { state, reason });
    this.changed(state, reason);
  }
}
