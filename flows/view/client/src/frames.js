// Frames of the scan with the objects that are marked in them.

import { make } from "./dom.js";
import { pathOf, source } from "./source.js";

/** The runs of a mask as an image: `color` where it is, nothing elsewhere. */
function painted(mask, color) {
  const [x0, y0, x1, y1] = mask.box;
  const image = new ImageData(x1 - x0, y1 - y0);
  let at = 0;
  mask.runs.forEach((length, index) => {
    if (index % 2) for (let pixel = at; pixel < at + length; pixel += 1) image.data.set(color, pixel * 4);
    at += length;
  });
  return image;
}

/** A color for an instance, the same in every frame. */
function colorOf(id) {
  const [red, green, blue] = [0, 2, 4].map((shift) => Math.round(127 + 110 * Math.cos(Number(id) * 2.399 + shift)));
  return [red, green, blue, 110];
}

/** The panel of a scene's frames; `choose` is told of an object that is clicked. */
export class Frames {
  constructor(place, document_, choose) {
    Object.assign(this, { place, document: document_, choose, selected: null, turn: 0 });
    const { excuse, rows } = document_.frames;
    this.picture = make("canvas", { class: "frame" });
    this.note = make("p", { class: "muted", textContent: excuse });
    this.list = make("select", { "aria-label": "Frame", onchange: () => this.open(this.list.value) });
    this.list.append(...rows.map((row) => make("option", { value: row.id, textContent: `frame ${row.id}, ${row.masks} marked` })));
    this.picture.addEventListener("click", (event) => this.#clicked(event));
    place.replaceChildren(...(rows.length && !excuse ? [this.list, this.picture, this.note] : [this.note]));
    this.isOpen = rows.length > 0 && !excuse;
  }

  /** Show the frame that sees an object best. */
  select(row) {
    this.selected = row?.id ?? null;
    const best = row?.frames.find((id) => [...this.list.options].some((option) => option.value === id));
    if (best && this.isOpen) this.list.value = best;
  }

  /** Draw the frame that is chosen. */
  async open(id = this.list.value) {
    if (!this.isOpen || !id) return;
    const turn = (this.turn += 1); // a frame that comes late must not be drawn over one that was asked for after it
    const path = `${pathOf(this.document.id)}/frames/${id}`;
    try {
      const [masks, blob] = await Promise.all([source.json(path), source.picture(`${path}/picture`)]);
      const picture = await createImageBitmap(blob);
      const layers = await Promise.all(masks.masks.map((mask) => createImageBitmap(painted(mask, this.#colorOf(mask)))));
      if (turn !== this.turn) return;
      this.masks = masks;
      this.#draw(masks, picture, layers);
      this.note.textContent = "Objects are marked where they were seen best; click one.";
    } catch (error) {
      if (turn === this.turn) this.note.textContent = error.message;
    }
  }

  #colorOf(mask) {
    const [red, green, blue, alpha] = colorOf(mask.id);
    return [red, green, blue, mask.id === this.selected ? 190 : alpha];
  }

  #draw(masks, image, layers) {
    Object.assign(this.picture, { width: masks.width, height: masks.height });
    const paint = this.picture.getContext("2d");
    paint.drawImage(image, 0, 0, masks.width, masks.height);
    for (const [index, mask] of masks.masks.entries()) {
      paint.drawImage(layers[index], mask.box[0], mask.box[1]);
      if (mask.id !== this.selected) continue;
      paint.strokeStyle = "#ffffff";
      paint.lineWidth = 2;
      paint.strokeRect(mask.box[0], mask.box[1], mask.box[2] - mask.box[0], mask.box[3] - mask.box[1]);
    }
    this.picture.dataset.drawn = masks.id;
  }

  #clicked(event) {
    const scale = this.picture.width / this.picture.clientWidth;
    const [x, y] = [event.offsetX * scale, event.offsetY * scale];
    const inside = this.masks?.masks.filter(({ box }) => x >= box[0] && x < box[2] && y >= box[1] && y < box[3]) ?? [];
    const area = ({ box }) => (box[2] - box[0]) * (box[3] - box[1]);
    if (inside.length) this.choose(inside.reduce((least, mask) => (area(mask) < area(least) ? mask : least)).id);
  }
}
