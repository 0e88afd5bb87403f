// The guidelines' figures of an answer: what they are, and which of them are bad.

import { make } from "../dom.js";

const DEEP_M = 0.002;
const FLOATING_M = 0.01;
const OUTSIDE_SHARE = 0.02;
const AWAY_M = 0.05;
const RATIO = 2; // boxes of which one holds more than twice the other

const centimetres = (length) => `${(length * 100).toFixed(1)} cm`;

/** Rows [name, text, isBad] of figures; what was not measured is left out. */
function rowsOf(figures) {
  const { size_ratio: ratio, collision_m: deep, floating_m: floating, outside_share: outside, scan_distance_m: away } = figures;
  const rows = [["category", figures.is_category_match ? "matches" : "another one", !figures.is_category_match]];
  rows.push(["size", `${ratio.toFixed(2)} of the scanned`, ratio > RATIO || ratio < 1 / RATIO]);
  if (figures.lookalikes) {
    rows.push(["look-alikes", `${figures.lookalikes_alike} of ${figures.lookalikes} the same`, figures.lookalikes_alike < figures.lookalikes]);
  }
  rows.push(["collision", deep ? `${centimetres(deep)} in ${figures.collides_with}` : "none", deep > DEEP_M]);
  if (floating !== null) rows.push(["floating", centimetres(floating), floating > FLOATING_M]);
  if (outside !== null) rows.push(["outside", `${(outside * 100).toFixed(0)} %`, outside > OUTSIDE_SHARE]);
  if (away !== null) rows.push(["from the scan", centimetres(away), away > AWAY_M]);
  return rows;
}

/** The section of the figures; `text` stands in their place where there are none. */
export function figureTable(figures, text = "") {
  const section = make("section", { class: "figures", "aria-label": "Figures" }, make("h3", { textContent: "Guidelines" }));
  if (!figures) {
    section.append(make("p", { class: "muted", textContent: text || "…" }));
    return section;
  }
  const cells = rowsOf(figures).map(([name, value, isBad]) => make("div", { class: isBad ? "bad" : "", "data-figure": name },
    make("dt", { textContent: name }), make("dd", { textContent: isBad ? `${value} ✗` : value, title: isBad ? "against the guidelines" : "" })));
  section.append(make("dl", { class: "facts" }, ...cells));
  return section;
}
