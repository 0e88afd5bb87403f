// The keyboard. Every key works wherever the focus is, but for what is being typed into a field.

import { factTable, make } from "../dom.js";

const STEP_M = 0.01;
const KEYS = [
  ["N, P", "next, previous of the list"],
  ["U", "next that is open"],
  ["Q, W, E", "choose, align, rank"],
  ["1 … 9, 0", "choose a candidate; when ranking: 2nd to 5th, again takes it out"],
  ["X", "none fits"],
  ["M, R, S", "handles that move, turn, scale"],
  ["← → ↑ ↓", "move by 1 cm; with Shift by 10 cm; on a ranked candidate: its rank"],
  ["Page ↑ ↓", "lift, lower by 1 cm; with Shift by 10 cm"],
  [", .", "turn by 5°; with Shift by 1°"],
  ["+ −", "larger, smaller by 2 %"],
  ["B, G", "down on what is below, down on the floor"],
  ["L", "let it settle"],
  ["Z, Y", "undo, redo; also with Ctrl"],
  ["F, O, T", "look at the object, the room, from above"],
  ["V", "the camera of the photo"],
  ["C", "the scan over, beside, alone, away"],
  ["Enter", "save and go on; in a field: take it over; with Ctrl from anywhere"],
  ["Y, X", "in review: passes, fails (Ctrl+Enter in the remark fails, too)"],
  ["/", "search"],
  ["Esc", "leave a field"],
];

/** All keys as a table. */
export const keyList = () => Object.assign(factTable(KEYS), { className: "facts keys" });

/** Whether an element takes text. */
const isText = (node) => node.matches?.("textarea, input[type=search], input[type=text]") ?? false;

/** Keys that a field keeps for itself: numbers their digits, buttons and boxes what presses them. */
function isKept(node, event) {
  if (isText(node)) return event.key !== "Escape";
  if (node.matches?.("input[type=number]")) return event.key.length === 1 ? /[-+0-9.,]/.test(event.key) : !["Escape", "PageUp", "PageDown"].includes(event.key);
  if (node.matches?.("button, input[type=checkbox], summary")) return event.key === " " || (event.key === "Enter" && !node.matches("input"));
  return false;
}

/** Listen for keys; `app` does what they ask for. */
export function listen(app) {
  const byKey = {
    n: () => app.step(1), p: () => app.step(-1), u: () => app.nextOpen(), q: () => app.turnTo("choose"), w: () => app.turnTo("align"), e: () => app.turnTo("rank"),
    x: () => (app.isReviewing ? app.handing.judge(false) : app.editing.choose(null)), y: () => (app.isReviewing ? app.handing.judge(true) : app.editing.redo()),
    m: () => app.handles("translate"), r: () => app.handles("rotate"), s: () => app.handles("scale"),
    b: () => app.editing.putDown("support"), g: () => app.editing.putDown("floor"), l: () => app.editing.settle(), z: () => app.editing.undo(),
    f: () => app.stage.look("near"), o: () => app.stage.look("corner"), t: () => app.stage.look("above"), v: () => app.stage.look("photo"),
    c: () => app.nextScanMode(), Enter: () => app.handing.save(), "/": () => app.nodes.search.focus(), "?": () => app.nodes.help.showModal(),
    ",": () => app.editing.turn(5), ".": () => app.editing.turn(-5), "<": () => app.editing.turn(1), ">": () => app.editing.turn(-1), ";": () => app.editing.turn(1), ":": () => app.editing.turn(-1),
    "+": () => app.editing.grow(1.02), "=": () => app.editing.grow(1.02), "-": () => app.editing.grow(1 / 1.02),
    Escape: () => document.activeElement?.blur(),
  };
  addEventListener("keydown", (event) => {
    if (app.nodes.help.open || app.nodes.asked.open || event.altKey || event.defaultPrevented) return;
    const action = event.ctrlKey || event.metaKey ? withControl(app, event) : isKept(event.target, event) ? null : plain(app, byKey, event);
    if (!action) return;
    event.preventDefault();
    action();
  });
}

function withControl(app, event) {
  const key = event.key.toLowerCase();
  if (key === "enter") return () => (app.isReviewing ? app.handing.judge(!isText(event.target)) : app.handing.save());
  if (isText(event.target)) return null;
  if (key === "z") return () => (event.shiftKey ? app.editing.redo() : app.editing.undo());
  return key === "y" ? () => app.editing.redo() : null;
}

function plain(app, byKey, event) {
  const { key, target } = event;
  const length = (event.shiftKey ? 10 : 1) * STEP_M;
  const digit = "1234567890".indexOf(key);
  if (digit >= 0) return () => app.editing.digit(digit);
  const ranked = target.closest?.("[data-rank]");
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  if (key in arrows) {
    const [right, ahead] = arrows[key];
    return ranked ? () => app.editing.moveRank(Number(ranked.dataset.slot), right - ahead) : () => app.editing.nudge(right * length, ahead * length, 0);
  }
  if (key === "PageUp" || key === "PageDown") return () => app.editing.nudge(0, 0, key === "PageUp" ? length : -length);
  return byKey[key.length === 1 ? key.toLowerCase() : key] ?? null;
}
