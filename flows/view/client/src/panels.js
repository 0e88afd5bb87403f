// What stands beside the scene: the list of scenes, the objects by what carries them, and what is known of the one that is selected.

import { factTable, make } from "./dom.js";
import { overlaps } from "./marks.js";
import { pathOf, source } from "./source.js";
import { thumbnail } from "./thumbnails.js";

const MOST_LISTED = 200;

/** Scenes by name, with a field to filter them where there are many. */
export function sceneList(listing, open) {
  const list = make("ul", { class: "scenes", "aria-label": "Scenes" });
  const filter = make("input", { type: "search", placeholder: `Filter ${listing.scenes.length} scenes`, "aria-label": "Filter scenes" });
  const fill = () => {
    const wanted = filter.value.trim().toLowerCase();
    const rows = listing.scenes.filter((row) => `${row.id} ${row.room}`.toLowerCase().includes(wanted));
    const more = rows.length > MOST_LISTED ? [make("li", { class: "muted", textContent: `and ${rows.length - MOST_LISTED} more` })] : [];
    list.replaceChildren(...rows.slice(0, MOST_LISTED).map((row) => sceneItem(row, open)), ...more);
  };
  filter.addEventListener("input", fill);
  fill();
  return make("div", {}, listing.scenes.length > 8 ? filter : null, list);
}

function sceneItem(row, open) {
  const wrong = (row.deep ?? 0) + row.unstable;
  const size = row.area === undefined || row.area === null ? "" : `, ${row.area.toFixed(0)} m²`;
  const about = `${row.room}${size}, ${row.placed ?? "no"} objects`;
  const badge = wrong ? make("span", { class: "badge", textContent: String(wrong), title: `${row.unstable} do not stay, ${row.deep} overlap` }) : null;
  const texts = make("span", {}, make("strong", { textContent: row.id }), make("small", { textContent: about }));
  return make("li", {}, make("button", { type: "button", "data-scene": row.id, onclick: () => open(row.id) }, texts, badge));
}

/** Objects below what carries them. */
export function objectTree(document_, choose) {
  const known = new Set(document_.objects.map((row) => row.id));
  const below = new Map();
  for (const row of document_.objects) {
    const parent = row.support?.parent && known.has(row.support.parent) ? row.support.parent : "";
    below.set(parent, [...(below.get(parent) ?? []), row]);
  }
  const branch = (parent, seen) => {
    const rows = (below.get(parent) ?? []).filter((row) => !seen.has(row.id));
    const inner = new Set([...seen, ...rows.map((row) => row.id)]);
    const name = (row) => `${row.category} ${row.id}`;
    rows.sort((a, b) => name(a).localeCompare(name(b)));
    return rows.map((row) => {
      const children = branch(row.id, inner);
      return make("li", {}, objectItem(row, choose), children.length ? make("ul", {}, ...children) : null);
    });
  };
  return make("ul", { class: "objects", "aria-label": "Objects, below what carries them" }, ...branch("", new Set()));
}

function objectItem(row, choose) {
  const mark = row.unstable.length || row.remains ? make("span", { class: "badge shaky", textContent: "!", title: row.remains ?? "does not stay" }) : null;
  const how = { wall: "on a wall", ceiling: "hangs", none: "in the air" }[row.support?.relation] ?? (row.placed ? "" : "not placed");
  const button = make("button", { type: "button", "data-instance": row.id, onclick: () => choose(row.id) });
  button.append(make("span", { textContent: row.category }), make("small", { textContent: `${row.id} ${how}` }));
  if (mark) button.append(mark);
  return button;
}

/** What is known of a scene as a whole. */
export function sceneFacts(document_, choose) {
  const names = new Map(document_.objects.map((row) => [row.id, row.category]));
  const wrong = document_.objects.filter((row) => row.unstable.length || row.remains);
  const named = (id) => (names.has(id) ? `${names.get(id)} ${id}` : id);
  const entry = (id, text) => make("li", {}, make("button", { type: "button", class: "link", textContent: text, onclick: () => choose(id) }));
  const shaky = wrong.map((row) => entry(row.id, `${named(row.id)}: ${row.remains ?? `does not stay (${row.unstable.join(", ")})`}`));
  const pairs = (time) =>
    overlaps(document_, time).map((pair) => entry(pair.a, `${named(pair.a)} and ${named(pair.b)}: ${(pair.depth * 1000).toFixed(1)} mm`));
  const section = (title, entries, none) =>
    make("section", {}, make("h3", { textContent: `${title} (${entries.length})` }),
      entries.length ? make("ul", { class: "plain" }, ...entries) : make("p", { class: "muted", textContent: none }));
  return [
    make("h2", { textContent: document_.id }), factTable(document_.facts),
    section("Does not stay", shaky, "Every object stays where it was put."),
    section("Overlap after the optimization", pairs(1), "No pair is deeper than 2 mm."),
    section("Overlapped before", pairs(0), "No pair was deeper than 2 mm."),
    make("p", { class: "muted", textContent: "Click an object, here or in the scene, for what is known of it. ? lists the keys." }),
  ];
}

/** What is known of an object: its picture, its candidates to try, its facts, and where all that comes from. */
export function objectFacts(document_, row, tried, attempt) {
  const photo = make("img", { class: "photo", alt: `How the scan shows ${row.category} ${row.id}` });
  if (row.view) show(photo, row.view);
  const head = make("header", {}, make("h2", { textContent: row.category }), make("code", { textContent: `${document_.id}/${row.id}` }));
  return [
    make("div", { class: "head" }, head, row.view ? photo : null),
    ...(row.remains ? [make("p", { class: "remains", textContent: row.remains })] : []),
    candidates(row, tried, attempt),
    ...row.facts.map((group) => make("section", {}, make("h3", { textContent: group.title }), factTable(group.rows))),
    lineage(document_, row),
  ];
}

/** Candidates by rank, each to be tried in place. */
function candidates(row, tried, attempt) {
  const current = tried ?? row.candidates.find((offer) => offer.placed && offer.blob)?.slot ?? null;
  const tiles = row.candidates.map((offer, index) => {
    const picture = make("canvas", { "aria-hidden": "true" });
    const score = offer.score === null ? offer.outcome : `${offer.rank}. ${offer.score.toFixed(2)}`;
    const name = offer.name ?? offer.reason ?? offer.outcome;
    const title = [name, offer.provider, offer.fallback ? `fallback: ${offer.reason ?? ""}` : "", offer.placed ? "placed" : ""];
    const tile = make("button", {
      type: "button", class: offer.placed ? "tile placed" : "tile", title: title.filter(Boolean).join("\n"), disabled: !offer.blob || !offer.pose,
      "data-slot": String(offer.slot), "aria-pressed": String(offer.slot === current), onclick: () => attempt(offer),
    });
    tile.append(picture, make("span", { textContent: score }), make("small", { textContent: offer.provider }));
    if (index < 10 && offer.blob) tile.append(make("kbd", { textContent: String((index + 1) % 10) }));
    if (offer.blob) queueMicrotask(() => thumbnail(offer, picture));
    return tile;
  });
  const isTried = tried !== null && tried !== undefined;
  const back = make("button", { type: "button", class: "link", textContent: "show again what was placed", onclick: () => attempt(null), hidden: !isTried });
  const none = make("p", { class: "muted", textContent: "No candidates: it is of a finished dataset, or none were looked for." });
  return make("section", {}, make("h3", { textContent: `Candidates (${tiles.length})` }), tiles.length ? make("div", { class: "tiles" }, ...tiles) : none, back);
}

/** Runs of carts to be played: to an object where there are any, else all that the page has of the scene. */
export function driveList(document_, row, start) {
  const all = document_.drives;
  if (!all.length) return [];
  const own = row ? all.filter((run) => run.target === row.id) : [];
  const items = (own.length ? own : all).map((run) => {
    const whose = [run.policy, run.run, run.setup, run.body].filter((word) => word).join(", ");
    const texts = [make("span", { textContent: `A cart to the ${run.category}: ${run.outcome}` }),
      make("small", { textContent: `${run.episode}: ${run.seconds.toFixed(0)} s, off by ${(100 * run.error).toFixed(1)} cm; ${whose}` })];
    return make("li", {}, make("button", { type: "button", "data-drive": run.id, onclick: () => start(run) }, ...texts));
  });
  return [make("p", { class: "muted", textContent: "Runs of carts; the ring is where one believed to be" }), make("ul", { class: "walks" }, ...items)];
}

/** Episodes to be played: to an object where there are any, else all of the scene. */
export function walkList(document_, row, start) {
  const all = document_.episodes;
  const own = row ? all.filter((episode) => episode.target === row.id) : [];
  const name = row ? `${row.category} ${row.id}` : "";
  let about = all.length ? "" : "The lake has no episodes of this scene.";
  if (row && all.length) about = own.length ? `Episodes to ${name}` : `None leads to ${name}; all of the scene:`;
  const items = (own.length ? own : all).map((episode) => {
    const length = `${episode.geodesic.toFixed(1)} m, ${episode.actions.length} actions, ${episode.split}`;
    const texts = [make("span", { textContent: episode.instruction }), make("small", { textContent: `${episode.id}: ${length}` })];
    return make("li", {}, make("button", { type: "button", "data-episode": episode.id, onclick: () => start(episode) }, ...texts));
  });
  return [make("p", { class: "muted", textContent: about }), make("ul", { class: "walks" }, ...items)];
}

/** What `metascenes explain` says of an object, asked for when it is unfolded. */
function lineage(document_, row) {
  const text = make("pre", { textContent: "…" });
  const details = make("details", { class: "lineage" }, make("summary", { textContent: "What it was made from, link by link" }), text);
  let asked = false;
  details.addEventListener("toggle", async () => {
    if (details.open) details.scrollIntoView({ block: "start" });
    if (asked || !details.open) return;
    asked = true;
    try {
      text.textContent = (await source.json(`${pathOf(document_.id)}/objects/${row.id}`)).text;
    } catch (error) {
      text.textContent = error.message;
    }
  });
  return details;
}

async function show(image, name) {
  try {
    const blob = new Blob([await source.bytes(name)], { type: "image/jpeg" });
    const address = URL.createObjectURL(blob);
    image.onload = () => URL.revokeObjectURL(address);
    image.src = address;
  } catch {
    image.remove();
  }
}
