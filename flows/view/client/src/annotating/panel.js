// What stands on the right: the photo of the object, what is known of it, its numbers and figures, and what to do with it.

import { make } from "../dom.js";

/** Photo, name and remarks of an object. */
export function about(row) {
  const photo = row.photo ? make("img", { class: "shot", src: row.photo.slice(1), alt: `The photo of ${row.category} ${row.instance_id}` }) : null;
  const remarks = (row.remarks ?? []).map((text) => make("li", { textContent: text }));
  const doubts = row.reasons?.length ? make("p", { class: "muted", textContent: `asked because: ${row.reasons.join(", ")}` }) : null;
  return [
    make("figure", { class: "photo-frame" }, photo, make("figcaption", { class: "muted", textContent: photo ? "" : "There is no photo of it." })),
    make("div", { class: "head" }, make("header", {}, make("h2", { textContent: row.category }), make("code", { textContent: row.key }))),
    row.caption ? make("p", { class: "muted", textContent: row.caption }) : null, doubts,
    remarks.length ? make("section", { class: "remarks", "aria-label": "Remarks of reviewers" }, make("h3", { textContent: "Remarks of reviewers" }), make("ul", { class: "plain" }, ...remarks)) : null,
  ].filter(Boolean);
}

/** How the view stands to the photo's camera, in words. */
export function asideText(degrees) {
  if (degrees === null) return "";
  const turned = Math.round(Math.abs(degrees));
  if (turned < 3) return "The view looks the same way as the photo.";
  return `The view is turned ${turned}° to the ${degrees > 0 ? "right" : "left"} of the photo.`;
}

/** What an annotator does with an object: save, take back, or leave the answer as it was. */
export function actions(row, on) {
  const act = (text, title, run, name = "toggle") => make("button", { type: "button", class: name, textContent: text, title, onclick: run });
  if (!row.is_open) return make("p", { class: "muted", textContent: "The batch is handed in: nothing can be changed now." });
  const taken = row.status === "answered" ? act("Take the answer back", "", on.withdraw) : null;
  const back = row.status === "draft" && row.answer ? act("Back to my answer", "Throw away what was changed since it was saved", on.back) : null;
  return make("div", { class: "acts done" }, act("Save and next", "Enter", on.save, "toggle strong"), act("Next open", "U", on.nextOpen), taken, back);
}

/** What a reviewer says of an answer. */
export function verdictBox(row, isOpen, on) {
  const remark = make("textarea", { rows: 3, "aria-label": "Remark", placeholder: "What is wrong with it", maxLength: 2000, value: row.verdict?.remark ?? "", disabled: !isOpen });
  const act = (text, title, passes) => make("button", {
    type: "button", class: "toggle", textContent: text, title, disabled: !isOpen, onclick: () => on.judge(passes),
  });
  const [passing, failing] = [act("Passes", "Y", true), act("Fails", "X", false)];
  const buttons = make("div", { class: "acts" }, passing, failing);
  const node = make("section", { class: "verdict", "aria-label": "Verdict" }, make("h3", { textContent: `Answered by ${row.annotator}` }), buttons, remark);
  const press = ({ verdict }) => [passing, failing].forEach((button, at) => button.setAttribute("aria-pressed", String(verdict?.passes === (at === 0))));
  return Object.assign(node, { remark, press });
}
