// The last photo, or an earlier one that the user was told of since, with what was found on it in boxes; and, where it was rendered, what is truly there.

import { card, drawn, element, write } from "./element.js";
import { wordsOf } from "./found.js";
import { firstFree, within } from "./labels.js";
import { pictureOf } from "./pictures.js";

const KEY = "Solid: found. Dashed: truly there, as the photo was rendered.";
const PATIENCE_MS = 150; // photos that fly past faster are not asked for

export class PhotoCard {
  #shot = null;
  #picture = null;
  #found = []; // what the user was told of it
  #current = null; // the one of these that is looked at
  #boxes = "";
  #open = []; // photos whose answers are not there
  #timer = null;
  #lost = null; // the shot that could not be had

  // `picked` is told which of the findings on it is clicked.
  constructor(log, picked) {
    this.log = log;
    this.picked = picked;
    this.image = element("img", { alt: "", hidden: "" });
    this.boxes = drawn("svg", { class: "boxes", "aria-hidden": "true" });
    this.caption = element("p");
    this.key = element("p", { class: "note", hidden: "" }, KEY);
    this.frame = element("div", { class: "photo", hidden: "" }, this.image, this.boxes);
    this.element = card("Photo", this.frame, this.caption, this.key);
    this.element.classList.add("photos");
    this.element.firstElementChild.className = "unseen";
    this.image.addEventListener("load", () => this.#outline());
    this.image.addEventListener("error", () => this.#lose());
    new ResizeObserver(() => this.#redraw()).observe(this.frame); // labels have no width while the dock is closed
  }

  show(moment, current) {
    const { story } = moment;
    this.#current = current;
    this.#open = moment.open;
    this.element.hidden = !(story.keepsPhotos || (story.shot.length && story.told.length) || story.goesOn);
    const last = moment.last("shot");
    const told = moment.last("told");
    const late = told && (!last || told.at_s >= last.at_s); // the drone may have taken one since
    const shot = late ? (story.shot[told.photo] ?? last) : last;
    this.#found = late ? toldOfOne(story, moment.count("told")) : [];
    if (shot !== this.#shot) this.#ask(shot, story.run);
    this.frame.hidden = !(story.keepsPhotos || story.goesOn) || (shot && (!this.#picture || shot === this.#lost));
    write(this.caption, shot ? this.#words(shot) : "No photo was taken yet.");
    this.#outline();
  }

  #ask(shot, run) {
    this.#shot = shot;
    this.#picture = pictureOf(this.log, run, shot);
    clearTimeout(this.#timer);
    this.key.hidden = !(this.#picture && shot.truth);
    this.image.hidden = true;
    if (!this.#picture) return;
    const { source } = this.#picture;
    this.#timer = setTimeout(() => {
      this.image.src = source;
      this.image.hidden = false;
    }, PATIENCE_MS);
    this.image.hidden = this.image.getAttribute("src") !== source;
  }

  #lose() {
    this.frame.hidden = this.key.hidden = true;
    this.#lost = this.#shot;
    write(this.caption, this.#words(this.#shot));
  }

  #words(shot) {
    const where = shot.waypoint === null ? "before the first waypoint" : `at waypoint ${shot.waypoint}`;
    const said = this.#found.map((finding) => ` Finding ${finding.no}: ${wordsOf(finding)}.`).join("");
    const missing = this.#picture && shot !== this.#lost ? "" : " It was not kept where this page can find it.";
    const open = this.#open.some(({ waypoint }) => waypoint === shot.waypoint) ? " Its answer is not there." : "";
    const file = /\.\w+$/.test(shot.source) ? `, from ${shot.source}` : ""; // what has no file has no name that people know
    return `Photo ${shot.number + 1}, ${where}${file}.${said}${open}${missing}`;
  }

  #redraw() {
    this.#boxes = "";
    this.#outline();
  }

  #outline() {
    const { naturalWidth, naturalHeight, complete, hidden } = this.image;
    const { width = naturalWidth, height = naturalHeight } = this.#picture ?? {};
    const shown = this.#shot && complete && !hidden && naturalWidth > 0;
    const truth = shown ? (this.#shot.truth ?? []) : [];
    const found = shown ? this.#found.filter(({ box }) => box) : [];
    const key = JSON.stringify([width, height, truth, found, found.indexOf(this.#current)]);
    if (key === this.#boxes) return;
    this.#boxes = key;
    this.boxes.setAttribute("viewBox", `0 0 ${width || 1} ${height || 1}`);
    const labels = found.map((finding) => label(finding, width));
    this.boxes.replaceChildren(
      ...truth.map((box) => rectangle(box, "truth")),
      ...found.map((finding) => this.#around(finding)),
      ...labels,
    );
    spread(labels, found.map(({ box }) => box), width, height);
  }

  // The box of a finding, which can be clicked.
  #around(finding) {
    const box = rectangle(finding.box, finding === this.#current ? "found current" : "found");
    box.addEventListener("click", () => this.picked(finding));
    return box;
  }
}

// The last of what was found, and what was found on the same photo before it, as far as that is shown.
function toldOfOne(story, count) {
  const { told } = story;
  let first = count - 1;
  while (first > 0 && told[first - 1].photo === told[count - 1].photo) first -= 1;
  return told.slice(first, count).filter((finding) => story.shows(finding));
}

function rectangle({ left_px: x, top_px: y, width_px: width, height_px: height }, style) {
  return drawn("rect", { x, y, width, height, class: style });
}

function label(finding, width) {
  return drawn("text", { "font-size": width / 36 }, `${finding.no} ${wordsOf(finding)}`);
}

// Puts each label at its box, where it is whole and covers no other.
function spread(labels, boxes, width, height) {
  const taken = [];
  labels.forEach((text, index) => {
    const { left_px: x, top_px: top, height_px: tall } = boxes[index];
    const em = Number(text.getAttribute("font-size"));
    const size = { width: Math.min(width, text.getComputedTextLength() + 0.1 * em), height: 1.3 * em };
    if (text.getComputedTextLength() > width) text.setAttribute("textLength", width);
    const rows = [1, 2, 3, 4].flatMap((row) => [top - row * size.height, top + tall + (row - 1) * size.height]);
    const place = firstFree(rows.map((y) => within({ x, y, ...size }, width, height)), taken);
    taken.push(place);
    text.setAttribute("x", place.x);
    text.setAttribute("y", place.y + 0.75 * size.height);
  });
}
