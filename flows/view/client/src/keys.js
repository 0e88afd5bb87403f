// The keyboard: works wherever the focus is, but in fields of text; sliders keep their arrows.

const CUT_STEP = 0.05;

export function keys(view) {
  const walksOrSettles = () => view.walking ?? view.settle;
  const byKey = {
    n: () => view.step(1),
    p: () => view.step(-1),
    x: () => view.attempt(null),
    f: () => view.look("object"),
    r: () => view.look("corner"),
    t: () => view.look("above"),
    "[": () => view.stepScene(-1),
    "]": () => view.stepScene(1),
    "?": () => view.nodes.help.showModal(),
    ArrowLeft: () => view.cut(Math.max(0, view.canvas.cut - CUT_STEP)),
    ArrowRight: () => view.cut(Math.min(1, view.canvas.cut + CUT_STEP)),
    " ": () => view.play(walksOrSettles()),
    Escape: () => {
      if (view.walk) view.stopWalk();
      view.select(null);
    },
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !view.document || view.nodes.help.open) return;
    const { target } = event;
    const isRange = target.type === "range";
    if (target.matches?.("input[type=search], select")) return;
    if (isRange && event.key.startsWith("Arrow")) return;
    if (event.key === " " && target.matches?.("button, summary")) return;
    const digit = "1234567890".indexOf(event.key);
    const action = digit >= 0 ? () => attemptAt(view, digit) : byKey[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
}

/** Try the candidate at a place of the list; the one that is shown already: show again what was placed. */
function attemptAt(view, index) {
  const offer = view.replica.rows.get(view.selected)?.candidates[index];
  if (offer) view.attempt(view.replica.tried.get(view.selected) === offer.slot ? null : offer);
}
