// What leaves the annotator's or reviewer's hands: answers, the batch as a whole, verdicts.

import { make } from "../dom.js";
import { counted, numbered } from "./saving.js";
import { Absence, ask, keyPath } from "./server.js";

export class Handing {
  /** `app`: the page. */
  constructor(app) {
    this.app = app;
    this.queue = Promise.resolve(); // whatever is handed in goes one after the other
  }

  /** Do something that the server may refuse, after what was begun before; what it says then is shown, and `back` is called. */
  #do(act, back = () => {}) {
    this.queue = this.queue.then(act).catch((error) => {
      back(error);
      this.app.say(error instanceof Absence ? `${error.message}: try again` : error.message, true);
    });
  }

  /** Make the draft the answer, and go on to the next open object meanwhile: until the server has the answer it has the draft. */
  save() {
    const { app } = this;
    const { current } = app;
    if (!app.isOpen || current.row.status === "saving") return;
    app.typed();
    app.editing.dropped();
    if (current.draft.isLost) {
      app.say(current.draft.lost, true);
      return;
    }
    current.row.status = "saving";
    this.#do(() => this.#answer(current), (error) => {
      if (current.row.status === "saving") current.row.status = "draft";
      error.message = `${current.row.category} ${current.row.instance_id} is kept as a draft, and not saved: ${error.message}`;
      app.saving.put(current.draft);
      app.refresh(current);
    });
    app.refresh(current);
    if (!app.nextOpen()) app.say("That was the last one.");
  }

  async #answer(entry) {
    const { app } = this;
    const { row, draft } = entry;
    await app.saving.flush(); // on the disk as a draft, whatever comes of the answer
    const { version } = draft;
    const answer = numbered(draft);
    const { figures } = await ask("POST", `answers/${keyPath(draft.key)}`, answer);
    Object.assign(row, { figures, answer });
    if (draft.version === version) {
      row.status = "answered";
      app.saving.release(draft);
    } else app.saving.put(draft); // it was changed meanwhile
    app.refresh(entry);
    await app.progress();
    if (app.entries.every((each) => each.row.status === "answered")) app.say("Everything that is asked of you is answered. Hand it in on the left.");
  }

  /** Take an answer back. */
  withdraw() {
    const { app } = this;
    const { current } = app;
    const { row, draft } = current;
    this.#do(async () => {
      await app.saving.flush();
      const { version } = draft;
      await ask("POST", `answers/${keyPath(row.key)}`, { withdrawn: true, ...counted(row.key) });
      if (draft.version === version) {
        row.status = "withdrawn";
        app.saving.release(draft);
      } else app.saving.put(draft); // it was changed meanwhile
      row.answer = null;
      app.refresh(current);
      app.progress();
    });
  }

  /** Throw away what was changed since an object was answered. */
  back() {
    const { app } = this;
    const { current } = app;
    const { row, draft } = current;
    app.editing.dropped();
    this.#do(async () => {
      await app.saving.flush();
      const { version } = draft;
      await ask("DELETE", `drafts/${keyPath(row.key)}`);
      if (draft.version === version) {
        draft.back(row.answer);
        row.status = "answered";
        app.saving.release(draft);
      } else app.saving.put(draft); // it was changed meanwhile
      app.refresh(current);
      if (current === app.current) app.redraw();
      app.progress();
    });
  }

  /** Hand the batch in, once the user has said so; where answers are missing, the server's reason is shown first. */
  submit(reason = "") {
    const { app } = this;
    const { asked } = app.nodes;
    const count = (isMeant) => app.entries.filter(({ row }) => isMeant(row)).length;
    const missing = count(({ status, answer }) => status !== "answered" && !answer);
    const changed = count(({ status, answer }) => status !== "answered" && answer);
    const texts = [missing ? `${missing} of your ${app.entries.length} objects are not answered.` : "All of your objects are answered."];
    if (changed) texts.push(`${changed} of them changed since answered: the answer is handed in as it was saved, without the changes.`);
    const act = (name, isPartial, style = "toggle") => make("button", {
      type: "button", class: style, textContent: name, onclick: () => {
        asked.close();
        this.#submit(isPartial);
      },
    });
    asked.replaceChildren(
      make("h2", { textContent: "Hand in the batch" }), ...texts.map((text) => make("p", { textContent: text })), reason ? make("p", { class: "remains", textContent: reason }) : "",
      make("div", { class: "acts" }, reason ? act("Hand in without what is missing", true) : act("Hand in", false, "toggle strong"),
        make("button", { type: "button", class: "toggle", textContent: "Cancel", onclick: () => asked.close() })),
    );
    asked.showModal();
  }

  #submit(isPartial) {
    const { app } = this;
    this.#do(async () => {
      await app.saving.flush();
      try {
        await ask("POST", "submit", { partial: isPartial });
      } catch (error) {
        if (error.status !== 409 || isPartial) throw error;
        this.submit(error.message);
        return;
      }
      await app.open(false);
      app.say("The batch is handed in.");
    });
  }

  /** Draw the answers that are reviewed. */
  sample() {
    this.#do(async () => {
      await ask("POST", "sample", {});
      await this.app.open(true);
    });
  }

  /** Say whether the answer passes; what fails needs a remark. */
  judge(passes) {
    const { app } = this;
    const { current } = app;
    if (!app.isReviewing || !current || app.me.batch.state !== "in_review") return;
    const field = app.verdict.remark;
    const remark = field.value.trim() || null;
    if (!passes && !remark) {
      app.say("What fails needs a remark: say what is wrong with it.", true);
      field.focus();
      return;
    }
    const { key, annotator, verdict } = current.row;
    current.row.verdict = { passes, remark };
    field.blur();
    this.#do(async () => {
      const { judged, sampled } = await ask("PUT", `verdicts/${keyPath(`${key}/${annotator}`)}`, { passes, remark });
      await app.progress();
      app.say(judged < sampled ? `${judged} of ${sampled} judged` : "All of the sample is judged. Conclude the review on the left.");
    }, () => {
      current.row.verdict = verdict;
      app.refresh(current);
    });
    app.refresh(current);
    app.nextOpen();
  }

  /** End the review: the batch is accepted, or goes back. */
  conclude() {
    this.#do(async () => {
      const told = await ask("POST", "conclude", {});
      await this.app.open(true);
      const range = `${(told.pass_low * 100).toFixed(1)} to ${(told.pass_high * 100).toFixed(1)} % of the batch are right`;
      this.app.say(`The batch is ${told.verdict}: ${told.passed} of ${told.sampled} pass, ${range}.`);
    });
  }
}
