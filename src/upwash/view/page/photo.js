// The last photo, or an earlier one that the user was told of since, with what was found on it in boxes; and, where it was rendered, what is truly there.

import { card, drawn, element, write } from "./element.js";

const KEY = "Solid: found. Dashed: truly there, as the photo was rendered.";
const PATIENCE_MS = 150; // photos that fly past faster are not asked for

export class PhotoCard {
  #shot = null;
  #boxes = "";
  #timer = null;
  #lost = null; // the shot that could not be had

  constructor(log) {
    this.log = log;
    this.image = element("img", { alt: "", hidden: "" });
    this.boxes = drawn("svg", { class: "boxes", "aria-hidden": "true" });
    this.caption = element("p");
    this.key = element("p", { class: "note", hidden: "" }, KEY);
    this.frame = element("div", { class: "photo", hidden: "" }, this.image, this.boxes);
    this.element = card("Photo", this.frame, this.caption, this.key);
    this.image.addEventListener("load", () => this.#outline());
    this.image.addEventListener("error", () => this.#lose());
  }

  show(moment) {
    const last = moment.last("shot");
    const told = moment.last("told");
    const found = last && told && told.at_s >= last.at_s ? told : null;
    const shot = found ? (moment.story.shot[found.number] ?? last) : last; // the drone may have taken one since
    this.element.hidden = !shot || !(shot.kept || moment.story.told.length);
    if (shot !== this.#shot) this.#ask(shot, moment.story.run);
    this.found = found;
    if (shot) write(this.caption, this.#words(shot, found));
    this.#outline();
  }

  #ask(shot, run) {
    this.#shot = shot;
    clearTimeout(this.#timer);
    this.frame.hidden = !shot?.kept;
    this.key.hidden = !(shot?.kept && shot.truth);
    if (!shot?.kept) return;
    const source = `photos/${this.log}/${run}/${shot.number}.jpg`;
    this.#timer = setTimeout(() => {
      this.image.src = source;
      this.image.hidden = false;
    }, PATIENCE_MS);
    this.image.hidden = this.image.getAttribute("src") !== source;
  }

  #lose() {
    this.frame.hidden = this.key.hidden = true;
    this.#lost = this.#shot;
    write(this.caption, this.#words(this.#shot, this.found));
  }

  #words(shot, found) {
    const where = shot.waypoint === null ? "before the first waypoint" : `at waypoint ${shot.waypoint}`;
    const said = found ? ` The user was told: ${found.words}.` : "";
    const missing = shot.kept && shot !== this.#lost ? "" : " It was not kept where this page can find it.";
    return `Photo ${shot.number + 1}, ${where}, from ${shot.source}.${said}${missing}`;
  }

  #outline() {
    const { naturalWidth: width, naturalHeight: height, complete, hidden } = this.image;
    const shown = this.#shot && complete && !hidden;
    const boxes = shown ? [...(this.#shot.truth ?? []), ...(this.found?.boxes ?? [])] : [];
    const key = JSON.stringify([width, height, boxes]);
    if (key === this.#boxes) return;
    this.#boxes = key;
    this.boxes.setAttribute("viewBox", `0 0 ${width || 1} ${height || 1}`);
    this.boxes.replaceChildren(...boxes.flatMap((box) => outline(box, width)));
  }
}

function outline(box, width) {
  const [x, y, size] = [box.left_px, box.top_px, width / 36];
  const rectangle = { x, y, width: box.width_px, height: box.height_px };
  if (box.score === undefined) return [drawn("rect", { ...rectangle, class: "truth" })];
  const words = `${box.label} ${(100 * box.score).toFixed(0)} %`;
  const beside = y > size * 1.3 ? y - size / 4 : y + box.height_px + size;
  const label = drawn("text", { x, y: beside, "font-size": size }, words);
  return [drawn("rect", { ...rectangle, class: "found" }), label];
}
