// What stands on the left: who is asked what, how far it is, and how far everybody is.

import { make } from "../dom.js";

const MARKS = { open: "○", draft: "◐", answered: "●", withdrawn: "⊘", saving: "…" };
const NEXT = {
  open: "Answer for every object, then hand the batch in.", submitted: "A reviewer draws the sample next.", in_review: "Reviewers judge the sample.",
  accepted: "The next run places what was chosen.", returned: "Correct the answers by the remarks, then hand the batch in again.",
};

/** An object, or a sampled answer, as an entry of the list. */
export function entry({ draft, row }, choose) {
  const verdict = row.verdict ? (row.verdict.passes ? "passes" : "fails") : null;
  const status = "annotator" in row ? (verdict ?? "open") : row.status;
  const mark = { passes: "✓", fails: "✗" }[status] ?? MARKS[status] ?? "";
  const who = "annotator" in row ? ` by ${row.annotator}` : "";
  const button = make("button", { type: "button", class: "entry", "data-key": entryKey(row), "data-status": status, onclick: () => choose(draft) },
    make("span", { class: "mark", textContent: mark, "aria-hidden": "true" }), make("span", { textContent: row.category }),
    make("small", { textContent: `${row.scene_id.split("/")[1]} ${row.instance_id}${who}` }));
  button.setAttribute("aria-label", `${row.category} ${row.key}${who}: ${status}`);
  if (row.remarks?.length) button.append(make("span", { class: "badge shaky", textContent: "!", title: row.remarks.join("\n") }));
  return make("li", {}, button);
}

/** The name of an entry: an object may be answered for by several. */
export const entryKey = (row) => ("annotator" in row ? `${row.key} ${row.annotator}` : row.key);

/** Whether a list shows an object: by what is searched for, and whether only open ones are wanted. */
export function isListed(row, wanted, onlyOpen) {
  const isDone = "annotator" in row ? Boolean(row.verdict) : row.status === "answered";
  if (onlyOpen && isDone) return false;
  const text = `${row.category} ${row.key} ${row.caption ?? ""} ${row.annotator ?? ""} ${row.status ?? ""}`.toLowerCase();
  return wanted.toLowerCase().split(/\s+/).every((word) => text.includes(word));
}

/** How far each person and the batch are. `on`: `submit()`, `sample()`, `conclude()`; null for what the caller may not do. */
export function progressParts(told, on) {
  const { batch, people, reviews } = told;
  const bars = people.map(({ person, assigned, answered, drafts }) => {
    const text = `${answered} of ${assigned}${drafts ? `, ${drafts} in work` : ""}`;
    return make("div", { class: "who" }, make("span", { textContent: person }),
      make("progress", { max: Math.max(1, assigned), value: answered, "aria-label": `${person}: ${text}` }), make("small", { textContent: text }));
  });
  const parts = [make("p", { class: "state" }, make("strong", { textContent: batch.state.replace("_", " ") }), batch.round ? ` round ${batch.round}` : null), ...bars];
  if (batch.state === "in_review" || reviews.judged) {
    parts.push(make("p", { class: "muted", textContent: `${reviews.judged} of ${reviews.sampled} judged, ${reviews.passed} pass` }));
  }
  parts.push(make("p", { class: "muted", textContent: NEXT[batch.state] ?? batch.next }));
  const act = (name, text, isOpen) => on[name] && isOpen && parts.push(make("button", { type: "button", class: "toggle act", textContent: text, onclick: on[name] }));
  act("submit", "Hand in", batch.state === "open" || batch.state === "returned");
  act("sample", "Draw the sample", batch.state === "submitted");
  act("conclude", "Conclude the review", batch.state === "in_review" && reviews.judged >= reviews.sampled);
  return parts;
}
