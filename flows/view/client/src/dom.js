// Elements made from data. Text is only ever set as text: what comes from the lake is never read as HTML.

/** An element with properties (`class`, `data-*` and `aria-*` as attributes, `on*` as listeners) and children. */
export function make(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "class" || name === "role" || name.startsWith("aria-") || name.startsWith("data-")) node.setAttribute(name, value);
    else node[name] = value;
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** A table of names and values. */
export function factTable(rows) {
  const cells = rows.map(([name, value]) => make("div", {}, make("dt", { textContent: name }), make("dd", { textContent: value })));
  return make("dl", { class: "facts" }, ...cells);
}

/** A button that stays pressed; `change` is told whether it is. */
export function toggle(text, title, pressed, change) {
  const button = make("button", { type: "button", class: "toggle", textContent: text, title, "aria-pressed": String(pressed) });
  button.press = (on) => {
    button.setAttribute("aria-pressed", String(on));
    change(on);
  };
  button.addEventListener("click", () => button.press(button.getAttribute("aria-pressed") !== "true"));
  return button;
}
