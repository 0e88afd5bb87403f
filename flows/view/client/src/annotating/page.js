// The elements of the page that stay while objects change.

import { make, toggle } from "../dom.js";
import { dragEdge } from "../layout.js";
import { keyList } from "./keys.js";

export const STEPS = [["choose", "1 Choose"], ["align", "2 Align"], ["rank", "3 Rank"]];
const SCANS = [["over", "Over"], ["beside", "Beside"], ["scan", "Scan"], ["replica", "Replica"]];
const HANDLES = [["translate", "Move", "M"], ["rotate", "Turn", "R"], ["scale", "Scale", "S"]];

const button = (text, title, onclick, more = {}) => make("button", { type: "button", class: "toggle", textContent: text, title, onclick, ...more });

/** All elements; `on` has what is to be done. */
export function pageOf(place, on) {
  const pressed = (rows, act) => Object.fromEntries(rows.map(([name, text, key]) => [name, button(text, key ?? "", () => act(name), { "aria-pressed": "false" })]));
  const nodes = {
    where: make("p", { class: "where" }),
    saved: make("p", { class: "saved", role: "status", "aria-live": "polite" }),
    progress: make("section", { class: "part progress" }),
    search: make("input", { type: "search", placeholder: "Search", "aria-label": "Search objects", oninput: () => on.search() }),
    list: make("ul", { class: "objects work", "aria-label": "Objects" }),
    onlyOpen: toggle("Open ones", "Only what is not answered", false, () => on.search()),
    roles: make("div", { class: "tabs", role: "tablist", "aria-label": "What is done", hidden: true }),
    view: make("div", { class: "view" }),
    edge: make("div", { class: "edge", hidden: true }),
    status: make("p", { class: "status", role: "status" }),
    scans: pressed(SCANS, on.scanMode),
    handles: pressed(HANDLES, on.handles),
    photoCamera: button("Camera of the photo", "V", () => on.look("photo")), // stands by the photo
    undo: button("↶", "Undo: Z", on.undo, { "aria-label": "Undo" }),
    redo: button("↷", "Redo: Y", on.redo, { "aria-label": "Redo" }),
    steps: Object.fromEntries(STEPS.map(([name, text]) => [name, make("button", {
      type: "button", role: "tab", textContent: text, "aria-selected": "false", "data-step": name, onclick: () => on.step(name),
    })])),
    hint: make("p", { class: "muted hint" }),
    tray: make("div", { class: "tray" }),
    pane: make("div", { class: "pane" }),
    help: make("dialog", { class: "help", "aria-label": "Keys" }),
    asked: make("dialog", { class: "help", "aria-label": "Hand in" }),
  };
  nodes.stepBar = make("div", { class: "tabs steps", role: "tablist", "aria-label": "Steps" }, ...Object.values(nodes.steps), nodes.hint);
  nodes.handleBar = make("span", { class: "group", role: "group", "aria-label": "Handles" }, ...Object.values(nodes.handles));
  nodes.help.append(make("h2", { textContent: "Keys" }), keyList(), button("Close", "Esc", () => nodes.help.close()));
  nodes.view.append(nodes.edge, nodes.status);
  const scans = make("span", { class: "group", role: "group", "aria-label": "The scan" }, ...Object.values(nodes.scans));
  const toolbar = make("div", { class: "bar top", role: "toolbar", "aria-label": "Scene" },
    scans, nodes.handleBar, nodes.undo, nodes.redo, make("span", { class: "gap" }),
    button("Object", "F", () => on.look("near")), button("Room", "O", () => on.look("corner")), button("Above", "T", () => on.look("above")),
    button("?", "Keys", () => nodes.help.showModal(), { "aria-label": "Keys" }));
  place.replaceChildren(
    make("aside", { class: "left", "aria-label": "Work" },
      make("header", {}, make("h1", { textContent: "Annotation" }), nodes.where), nodes.saved, nodes.roles, nodes.progress,
      make("div", { class: "part filter" }, nodes.search, nodes.onlyOpen), make("div", { class: "part object-part" }, nodes.list)),
    make("main", {}, toolbar, nodes.view, nodes.stepBar, nodes.tray),
    make("aside", { class: "right", "aria-label": "Object" }, nodes.pane), nodes.help, nodes.asked,
  );
  place.classList.add("annotate");
  dragEdge(nodes.edge, nodes.view, (share) => on.cut(share));
  return nodes;
}

/** Press one of some buttons, and none else. */
export function press(buttons, name) {
  for (const [each, node] of Object.entries(buttons)) node.setAttribute("aria-pressed", String(each === name));
}
