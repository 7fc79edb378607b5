// Everything that the user was told, newest first: a click goes to its moment, and to its photo.

import { card, element, scrolled, table } from "./element.js";

const HEADS = ["no.", "waypoint", "what", "at"];

export class Findings {
  #rows = [];
  #last = -1; // the index of the last one until the moment

  // `picked` is told the one that is clicked.
  constructor(name, picked) {
    this.picked = picked;
    this.body = element("tbody");
    this.scroller = scrolled(table(HEADS, this.body), `Findings, ${name}`);
    this.element = card("Findings", this.scroller);
    this.element.classList.add("findings");
  }

  show(moment) {
    const { story } = moment;
    this.element.hidden = story.told.length === 0;
    for (const told of story.told.slice(this.#rows.length)) {
      const row = this.#row(told, this.#rows.length + 1, story);
      row.classList.add("later");
      this.#rows.push(row);
      this.body.prepend(row);
    }
    this.#point(moment.count("told") - 1);
  }

  clear() {
    this.#rows = [];
    this.#last = -1;
    this.body.replaceChildren();
  }

  // Those after the moment are pale; the last until then is marked, and to be seen.
  #point(last) {
    if (last === this.#last) return;
    const [from, to] = [Math.min(last, this.#last), Math.max(last, this.#last)];
    for (let index = from + 1; index <= to; index += 1) this.#rows[index].classList.toggle("later", index > last);
    this.#rows[this.#last]?.removeAttribute("aria-current");
    this.#rows[last]?.setAttribute("aria-current", "true");
    this.#last = last;
    const row = this.#rows[Math.max(0, last)];
    const [top, bottom] = [row.offsetTop, row.offsetTop + row.offsetHeight];
    const { scrollTop, clientHeight } = this.scroller;
    if (top < scrollTop || bottom > scrollTop + clientHeight) this.scroller.scrollTop = top - clientHeight / 2;
  }

  #row(told, number, story) {
    const button = element("button", { type: "button", title: "To the moment and the photo" }, String(number));
    button.setAttribute("aria-label", `Finding ${number}: to its moment and its photo`);
    const cells = [told.waypoint ?? "", inWords(told), story.timeOf(told.at_s)];
    const row = element("tr", {}, element("th", { scope: "row" }, button));
    row.append(...cells.map((cell) => element("td", {}, String(cell))));
    row.addEventListener("click", () => this.picked(told));
    return row;
  }
}

// What was found, with how sure that is; or what else the user was told.
function inWords({ boxes, words }) {
  if (!boxes.length || boxes.some((box) => box.score === undefined)) return words;
  const scores = new Map();
  for (const { label, score } of boxes) scores.set(label, [...(scores.get(label) ?? []), percent(score)]);
  return [...scores].map(([label, all]) => `${label} ${all.join(", ")}`).join("; ");
}

export function percent(score) {
  return `${(100 * score).toFixed(0)} %`;
}
