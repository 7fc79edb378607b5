// Everything that was found, newest first, with pictures: a click shows its moment, its photo and its place.

import { badge } from "./badge.js";
import { card, element, scrolled, write } from "./element.js";
import { cropOf, filesOfFindings } from "./pictures.js";

const [WIDE_PX, HIGH_PX] = [96, 72]; // of a picture

export class Findings {
  #items = new Map(); // by number: its element in the list, and what writes its words
  #listed = []; // the findings as they are listed
  #numbered = []; // by story: with which numbers
  #counts = new Map(); // by story: how many lie before the moment
  #selected = null; // the one that was clicked
  #current = null;

  // Of so many logs of one drone or of a fleet; `picked` is told which one is clicked, and of which story it is.
  constructor(stories, name, { log = 0, picked }) {
    this.stories = stories;
    this.log = log; // of the first story
    this.picked = picked;
    this.words = element("p", { class: "sentence" });
    this.list = element("ol", { class: "finds", reversed: "" });
    this.scroller = scrolled(this.list, `Findings, ${name}`);
    this.element = card("Findings", this.words, this.scroller);
    this.element.classList.add("findings");
    this.element.querySelector("h3").after(downloads());
  }

  // Each flight at its moment; returns the one finding that is looked at, of the flight of that index.
  show(moments, focus = 0) {
    this.element.hidden = !this.stories.some((story) => story.told.length);
    this.#list();
    for (const moment of moments) this.#fade(moment);
    this.#point(this.#currentAt(moments[focus]));
    return this.#current;
  }

  select(story, finding) {
    this.#selected = finding;
    this.picked(story, finding);
  }

  // Lists what is new, or everything anew where numbers have changed.
  #list() {
    const { stories } = this;
    if (stories.every(({ found }, index) => found === this.#numbered[index])) return;
    this.#numbered = stories.map(({ found }) => found);
    write(this.words, stories[0].found.words);
    const all = stories.flatMap((story, index) => story.numbered.map((finding) => ({ story, index, finding })));
    all.sort((one, other) => other.finding.no - one.finding.no);
    const findings = all.map(({ finding }) => finding);
    const fresh = findings.length - this.#listed.length;
    const grew = fresh >= 0 && this.#listed.every((finding, index) => finding === findings[fresh + index]);
    if (!grew) this.#forget();
    this.list.prepend(...all.slice(0, grew ? fresh : all.length).map((each) => this.#item(each)));
    for (const finding of findings) this.#items.get(finding.no).say(finding);
    this.list.classList.toggle("pictureless", !findings.some(({ pictured }) => pictured));
    this.#listed = findings;
  }

  #forget() {
    this.#items.clear();
    this.#current = null;
    this.list.replaceChildren();
  }

  #item({ story, index, finding }) {
    const where = finding.waypoint === null ? "" : `waypoint ${finding.waypoint} · `;
    const place = `${where}${story.timeOf(finding.at_s)}`;
    const whose = this.stories.length > 1 ? [badge(index + 1), " "] : [];
    const [found, seen] = [element("bdi"), element("span", { class: "when" })];
    const words = element(
      "span",
      { class: "words" },
      element("span", { class: "number" }, String(finding.no)),
      " ",
      found,
      element("span", { class: "when" }, ...whose, place),
    );
    words.append(seen);
    const say = (object) => {
      write(found, wordsOf({ ...object, score: object.surest ?? undefined }));
      write(seen, seenOften(object));
    };
    const button = element("button", { type: "button", title: "Show its moment, its photo and its place" });
    button.append(picture(this.#cropOf(finding)), words);
    button.addEventListener("click", () => this.select(story, finding));
    const item = element("li", {}, button);
    item.classList.toggle("later", finding.index >= (this.#counts.get(story) ?? 0));
    this.#items.set(finding.no, { item, say });
    return item;
  }

  // The picture of the best sighting, which may be another drone's.
  #cropOf({ pictured, best: [log, index] }) {
    return cropOf(log, this.stories[log - this.log]?.run, { pictured, index });
  }

  // Those after the moment are pale.
  #fade(moment) {
    const { story } = moment;
    const [before, count] = [this.#counts.get(story) ?? 0, moment.count("told")];
    for (let index = Math.min(before, count); index < Math.max(before, count); index += 1) {
      const { no, sightings } = story.told[index];
      if (sightings !== undefined) this.#items.get(no)?.item.classList.toggle("later", index >= count);
    }
    this.#counts.set(story, count);
  }

  // The one that was clicked, while its message is the last; else the last.
  #currentAt(moment) {
    const last = moment.last("told");
    const isSelected = last && last.at_s === this.#selected?.at_s && moment.story.told[this.#selected.index] === this.#selected;
    return isSelected ? this.#selected : last;
  }

  #point(current) {
    if (current === this.#current) return;
    this.#items.get(this.#current?.no)?.item.removeAttribute("aria-current");
    this.#current = current;
    const item = this.#items.get(current?.no)?.item;
    if (!item) return;
    item.setAttribute("aria-current", "true");
    const [top, bottom] = [item.offsetTop, item.offsetTop + item.offsetHeight];
    const { scrollTop, clientHeight } = this.scroller;
    if (top < scrollTop || bottom > scrollTop + clientHeight) this.scroller.scrollTop = top - clientHeight / 2;
  }
}

// How often an object was seen, and how far from its place it may lie.
function seenOften({ sightings, error_m: errorM }) {
  const often = sightings > 1 ? `seen ${sightings} times` : "";
  return [often, errorM == null ? "" : `± ${errorM.toFixed(1)} m`].filter(Boolean).join(" · ");
}

function picture(source) {
  const frame = element("span", { class: "thumb" });
  if (!source) return frame;
  const image = element("img", { src: source, alt: "", width: WIDE_PX, height: HIGH_PX, loading: "lazy" });
  image.addEventListener("error", () => image.remove());
  frame.append(image);
  return frame;
}

function downloads() {
  const files = filesOfFindings();
  const links = files.map(([name, address]) => element("li", {}, element("a", { href: address, download: name }, name)));
  const menu = element("details", { class: "downloads" }, element("summary", {}, "Download"), element("ul", {}, ...links));
  menu.hidden = !files.length;
  return menu;
}

// What was found, and how sure that is.
export function wordsOf({ what, score }) {
  const name = what || "object"; // a simulated one has neither name nor score
  return score ? `${name} ${percent(score)}` : name;
}

function percent(score) {
  return `${(100 * score).toFixed(0)} %`;
}
