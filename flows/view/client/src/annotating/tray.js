// The ten candidates as pictures, and the places of the ranking: to be clicked, dragged, or reached by keys.

import { make } from "../dom.js";
import { thumbnail } from "../thumbnails.js";
import { RANKED } from "./draft.js";

const PLACES = ["2nd", "3rd", "4th", "5th"];
const DRAG_PX = 6;

/** Candidates and ranking of a draft. `on`: `pick(slot)`, `rank(slot, place)`, `none()`; null where nothing may be changed. */
export function tray(draft, step, on) {
  const offers = draft.offers;
  const tiles = offers.map((offer, index) => tile(draft, offer, index, step, on));
  const none = make("button", {
    type: "button", class: "toggle none", textContent: "None fits", hidden: !on && draft.now.choice !== null, title: "X", disabled: !on, "aria-pressed": String(draft.now.choice === null), onclick: () => on.none(),
  });
  const parts = [make("div", { class: "tiles ten", role: "group", "aria-label": "Candidates" }, ...tiles, none)];
  if (step === "rank") parts.push(ranking(draft, on));
  return parts;
}

function tile(draft, offer, index, step, on) {
  const { choice } = draft.now;
  const place = draft.now.ranking.indexOf(offer.slot);
  const rank = choice === offer.slot ? "best" : (PLACES[place] ?? "");
  const key = String((index + 1) % 10);
  const about = `${offer.name}, ${offer.category}, ${offer.provider}${rank ? `, ${rank}` : ""}`;
  const node = make("button", {
    type: "button", class: choice === offer.slot ? "tile placed" : "tile", title: `${about}\n${offer.license}`, "aria-label": `${key}: ${about}`, disabled: !on,
    "data-slot": String(offer.slot), "aria-pressed": String(step === "rank" ? place >= 0 : choice === offer.slot),
    onclick: () => on.pick(offer.slot),
  });
  const score = offer.score === null ? "" : offer.score.toFixed(2);
  node.append(picture(offer), make("span", { textContent: rank || score }), make("small", { textContent: offer.category }), make("kbd", { textContent: key }));
  if (on && step === "rank" && choice !== offer.slot) draggable(node, offer.slot, on);
  return node;
}

function ranking(draft, on) {
  const places = PLACES.slice(0, RANKED).map((name, place) => {
    const slot = draft.now.ranking[place];
    const offer = slot === undefined ? null : draft.candidate(slot);
    const box = make("li", { class: offer ? "place" : "place empty", "data-place": String(place) }, make("span", { class: "ordinal", textContent: name }));
    if (!offer) {
      box.append(make("small", { textContent: on ? "drag here, or press a number" : "nothing" }));
      return box;
    }
    const node = make("button", {
      type: "button", class: "tile", "data-slot": String(slot), "data-rank": String(place), disabled: !on,
      "aria-label": `${name}: ${offer.name}; arrows move it, a click takes it out`, onclick: () => on.rank(slot, null),
    });
    node.append(picture(offer), make("small", { textContent: offer.category }));
    if (on) draggable(node, slot, on);
    box.append(node);
    return box;
  });
  return make("ol", { class: "ranking", "aria-label": "Ranking: the next best" }, ...places);
}

const drawn = new Map(); // slot's model -> picture, drawn once where the server has none

function picture(offer) {
  if (offer.thumbnail) return make("img", { src: offer.thumbnail.slice(1), alt: "", draggable: false, loading: "lazy" });
  const name = offer.glb.split("/").pop();
  if (!drawn.has(name)) {
    const canvas = make("canvas", { "aria-hidden": "true" });
    drawn.set(name, canvas);
    queueMicrotask(() => thumbnail({ blob: name, scale: [1, 1, 1] }, canvas));
  }
  const [own, copy] = [drawn.get(name), make("canvas", { "aria-hidden": "true" })];
  if (!own.isConnected) return own;
  Object.assign(copy, { width: own.width, height: own.height });
  copy.getContext("2d").drawImage(own, 0, 0);
  return copy;
}

/** Let a tile be dragged to a place of the ranking; dropped elsewhere, one that was ranked is taken out. */
function draggable(node, slot, on) {
  let start = null;
  let hasMoved = false;
  const placeAt = (event) => document.elementsFromPoint(event.clientX, event.clientY).map((each) => each.closest("[data-place]")).find(Boolean);
  const clear = () => {
    for (const each of document.querySelectorAll(".place.aim")) each.classList.remove("aim");
    node.classList.remove("dragged");
    node.style.transform = "";
  };
  node.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    start = [event.clientX, event.clientY];
    hasMoved = false;
    node.setPointerCapture(event.pointerId);
  });
  node.addEventListener("pointermove", (event) => {
    if (!start) return;
    const [x, y] = [event.clientX - start[0], event.clientY - start[1]];
    hasMoved ||= Math.hypot(x, y) > DRAG_PX;
    if (!hasMoved) return;
    clear();
    node.classList.add("dragged");
    node.style.transform = `translate(${x}px, ${y}px)`;
    placeAt(event)?.classList.add("aim");
  });
  node.addEventListener("pointerup", (event) => {
    const place = hasMoved ? placeAt(event) : null;
    start = null;
    clear();
    if (place) on.rank(slot, Number(place.dataset.place));
    else if (hasMoved && node.dataset.rank) on.rank(slot, null);
  });
  node.addEventListener("pointercancel", () => {
    start = null;
    clear();
  });
  node.addEventListener("click", (event) => {
    if (hasMoved) event.stopImmediatePropagation();
    hasMoved = false;
  }, true);
}
