// The elements of the page that stay while scenes change.

import { make, toggle } from "./dom.js";

const KEYS = [
  ["drag, right drag, wheel", "turn, move, come nearer"],
  ["click", "select what is under the pointer"],
  ["N, P", "next, previous object"],
  ["1 … 9, 0", "try a candidate of the selected object"],
  ["X", "show again what was placed"],
  ["F", "look at the selected object"],
  ["R, T", "the whole room from a corner, from above"],
  ["← →", "move the edge between scan and replica"],
  ["space", "play how it settles, or the episode"],
  ["[ ]", "previous, next scene"],
  ["Esc", "select nothing"],
];

/** All elements; `on` has what is to be done: `layer(name, on)`, `cut(share)`, `time(moment)`, `play()`, `tab(name)`. */
export function layout(page, on) {
  const layers = {
    points: toggle("Points", "The scan as points", false, (value) => on.layer("points", value)),
    problems: toggle("Problems", "What overlaps (red), what does not stay (orange)", true, (value) => on.layer("problems", value)),
    supports: toggle("Supports", "What carries what", false, (value) => on.layer("supports", value)),
    colliders: toggle("Colliders", "Convex pieces that collide in simulators", false, (value) => on.layer("colliders", value)),
    navmesh: toggle("Navmesh", "Where an agent can go", false, (value) => on.layer("navmesh", value)),
  };
  const cut = make("input", { type: "range", min: 0, max: 100, value: 45, "aria-label": "Share of the picture that shows the scan" });
  cut.addEventListener("input", () => on.cut(cut.value / 100));
  const time = make("input", { type: "range", min: 0, max: 2, step: 0.01, value: 1, "aria-label": "From proposed to optimized to settled" });
  time.addEventListener("input", () => on.time(Number(time.value)));
  const play = make("button", { type: "button", class: "play", textContent: "▶", title: "Play how it settles", "aria-label": "Play how it settles", onclick: on.play });
  const stops = ["proposed", "optimized", "settled"].map((name, moment) =>
    make("button", { type: "button", class: "stop", textContent: name, "data-time": String(moment), onclick: () => on.time(moment) }));
  const nodes = {
    layers, cut, time, play, stops,
    where: make("p", { class: "where" }),
    scenes: make("div", { class: "part scene-part" }),
    objects: make("div", { class: "part object-part" }),
    view: make("div", { class: "view" }),
    edge: make("div", { class: "edge" }),
    ends: [make("span", { class: "end scan", textContent: "Scan" }), make("span", { class: "end replica", textContent: "Replica" })],
    label: make("div", { class: "label", hidden: true }),
    inset: make("div", { class: "inset", hidden: true }),
    status: make("p", { class: "status", role: "status" }),
    panes: { object: make("div", { class: "pane" }), walks: make("div", { class: "pane", hidden: true }), frames: make("div", { class: "pane", hidden: true }) },
    help: help(),
  };
  nodes.tabs = Object.fromEntries([["object", "Facts"], ["walks", "Episodes"], ["frames", "Frames"]].map(([name, text]) => {
    const tab = make("button", { type: "button", role: "tab", textContent: text, "aria-selected": String(name === "object"), "data-tab": name });
    tab.addEventListener("click", () => on.tab(name));
    return [name, tab];
  }));
  nodes.view.append(nodes.edge, ...nodes.ends, nodes.label, nodes.inset, nodes.status);
  const toolbar = make("div", { class: "bar top", role: "toolbar", "aria-label": "Layers" }, ...Object.values(layers),
    make("span", { class: "gap" }),
    make("button", { type: "button", class: "toggle", textContent: "From above", title: "T", onclick: () => on.camera("above") }),
    make("button", { type: "button", class: "toggle", textContent: "Whole room", title: "R", onclick: () => on.camera("corner") }),
    make("button", { type: "button", class: "toggle", textContent: "?", title: "Keys", "aria-label": "Keys", onclick: () => nodes.help.showModal() }));
  const bottom = make("div", { class: "bar bottom" },
    make("label", { class: "cut" }, make("span", { textContent: "replica" }), cut, make("span", { textContent: "scan" })),
    make("div", { class: "settle" }, play, make("div", { class: "track" }, time, make("div", { class: "stops" }, ...stops))));
  page.replaceChildren(
    make("aside", { class: "left" }, make("header", {}, make("h1", { textContent: "Scene lake" }), nodes.where), nodes.scenes, nodes.objects),
    make("main", {}, toolbar, nodes.view, bottom),
    make("aside", { class: "right" }, make("div", { class: "tabs", role: "tablist" }, ...Object.values(nodes.tabs)), ...Object.values(nodes.panes)),
    nodes.help,
  );
  dragEdge(nodes.edge, nodes.view, (share) => on.cut(share));
  return nodes;
}

function help() {
  const rows = KEYS.map(([key, text]) => make("div", {}, make("dt", {}, make("kbd", { textContent: key })), make("dd", { textContent: text })));
  const dialog = make("dialog", { class: "help", "aria-label": "Keys" }, make("h2", { textContent: "Keys" }), make("dl", { class: "facts keys" }, ...rows));
  dialog.append(make("button", { type: "button", class: "toggle", textContent: "Close", onclick: () => dialog.close() }));
  return dialog;
}

/** Let people take the edge between scan and replica and move it. */
export function dragEdge(edge, view, moved) {
  edge.addEventListener("pointerdown", (event) => {
    edge.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  edge.addEventListener("pointermove", (event) => {
    if (!edge.hasPointerCapture(event.pointerId)) return;
    const { left, width } = view.getBoundingClientRect();
    moved(Math.min(1, Math.max(0, (event.clientX - left) / width)));
  });
}
