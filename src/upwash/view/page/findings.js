// Everything that was found, with pictures: a click shows its moment, its photo and its place.

import { badge } from "./badge.js";
import { Choice } from "./choice.js";
import { element, keyOf, write } from "./element.js";
import { wordsOf } from "./found.js";
import { cropOf, filesOfFindings, loadSeen } from "./pictures.js";
import { ReviewPanel } from "./review.js";

const [WIDE_PX, HIGH_PX] = [96, 72]; // of a picture
const STEPS = { ArrowDown: 1, ArrowUp: -1, Home: -Infinity, End: Infinity };

export class Findings {
  #items = new Map(); // by number: its element in the list, its finding, and what writes its words
  #listed = []; // the findings as they are listed
  #numbered = []; // by story: with which numbers
  #counts = new Map(); // by story: how many lie before the moment
  #selected = null; // the one that was clicked
  #target = null; // the one that is reviewed, which stays while the moment moves on
  #focuses = false; // on what is selected, once that is listed
  #current = null;
  #pointed; // its element

  // Of so many logs of one drone or of a fleet; `picked` is told which one is clicked, and of which story it is.
  constructor(stories, name, { log = 0, picked, desk, changed }) {
    this.stories = stories;
    this.log = log; // of the first story
    this.picked = picked;
    this.words = element("p", { class: "sentence" });
    this.list = element("ol", { class: "finds" });
    this.scroller = element("div", { class: "scroll", role: "region", "aria-label": `Findings, ${name}` }, this.list);
    this.list.addEventListener("keydown", (event) => this.#step(event));
    this.choice = new Choice(stories, changed);
    const [move, advance] = [(by) => this.#move(by), (target) => this.#advance(target)];
    this.review = new ReviewPanel(stories, name, desk, { log, move, advance, changed });
    this.menu = downloads();
    this.nothing = element("p", { class: "note" }, "Nothing was found yet.");
    this.work = element("div", { class: "work" }, this.words, this.menu, this.choice.element, this.review.element, this.scroller);
    this.element = element("section", { class: "findings", "aria-label": "Findings" }, this.nothing, this.work);
  }

  // How many there are.
  get count() {
    return this.stories.reduce((sum, story) => sum + story.objects.length, 0);
  }

  // Each flight at its moment; returns the one finding that is looked at, of the flight of that index.
  show(moments, focus = 0) {
    this.work.hidden = !this.stories.some((story) => story.told.length);
    this.nothing.hidden = !this.work.hidden;
    this.#list();
    for (const moment of moments) this.#fade(moment);
    this.#point(this.#currentAt(moments[focus]));
    this.review.show(this.#reviewed);
    return this.#current;
  }

  select(story, finding) {
    this.#selected = finding;
    this.#target = this.#items.get(finding.no) ?? null;
    this.picked(story, finding);
  }

  // Puts the focus into the list.
  enter() {
    (this.list.querySelector("[tabindex='0']") ?? this.choice.sort).focus();
  }

  // What a key does with findings, if it does something. `isHere` says that the focus is among them.
  wayOf(key, isHere) {
    if (this.work.hidden) return null;
    return { s: () => this.choice.turn(), e: () => this.#offer() }[key] ?? this.review.wayOf(key, isHere);
  }

  #offer() {
    this.menu.open = true;
    this.menu.querySelector("a")?.focus();
  }

  // What is reviewed, as long as it has not got lost with the run of a log.
  get #reviewed() {
    const { story, finding } = this.#target ?? {};
    return story?.told[finding.index] === finding ? this.#target : null;
  }

  #step(event) {
    if (!(event.key in STEPS)) return;
    event.preventDefault();
    this.#move(STEPS[event.key]);
  }

  // Selects the one that many places further down the list, the first one where none is selected, and puts the focus on it.
  #move(by) {
    const at = this.#listed.indexOf(this.#reviewed?.finding);
    const next = this.#listed[at < 0 ? 0 : Math.max(0, Math.min(at + by, this.#listed.length - 1))];
    this.#goTo(this.#items.get(next?.no), true);
  }

  // Selects that one, or else the next one that nobody has reviewed; the focus goes with it, if it was in the list.
  #advance(target) {
    const at = this.#listed.indexOf(this.#reviewed?.finding);
    const order = [...this.#listed.slice(at + 1), ...this.#listed.slice(0, Math.max(0, at))];
    const next = target ?? this.#items.get(order.find(({ review }) => !review || review.verdict === "open")?.no);
    this.#goTo(next ?? this.#reviewed, this.list.contains(document.activeElement));
  }

  #goTo(target, focuses) {
    if (!target) return;
    this.#focuses ||= focuses;
    this.select(target.story, target.finding);
    this.#target = target;
  }

  // Lists what is new, or everything anew where numbers have changed.
  #list() {
    const { stories } = this;
    if (stories.every(({ found }, index) => found === this.#numbered[index])) return;
    this.#numbered = stories.map(({ found }) => found);
    write(this.words, stories[0].found.words);
    const all = stories.flatMap((story, index) => story.numbered.map((finding) => ({ story, index, finding })));
    all.sort((one, other) => this.choice.order(one.finding, other.finding));
    const findings = all.map(({ finding }) => finding);
    const made = new Map([...this.#items.values()].map((each) => [each.finding, each]));
    const kept = all.map((each) => made.get(each.finding) ?? this.#make(each));
    this.#items = new Map(kept.map((each) => [each.finding.no, each]));
    this.#lay(kept.map(({ item }) => item));
    for (const { say } of kept) say();
    this.list.classList.toggle("pictureless", !findings.some(({ pictured }) => pictured));
    this.#listed = findings;
    this.choice.tell(stories.flatMap((story) => story.objects), findings.length);
    this.#rove(this.list.querySelector("[tabindex='0']"));
  }

  // Puts the items into the list, and moves none that is there: it may have the focus.
  #lay(items) {
    const wanted = new Set(items);
    for (const item of [...this.list.children]) if (!wanted.has(item)) item.remove();
    let there = this.list.firstElementChild;
    for (const item of items) {
      if (item === there) there = there.nextElementSibling;
      else this.list.insertBefore(item, there);
    }
  }

  // Of all buttons in the list, Tab goes to one.
  #rove(to) {
    const next = to ?? this.list.querySelector("button");
    for (const each of this.list.querySelectorAll("[tabindex='0']")) each.tabIndex = -1;
    if (next) next.tabIndex = 0;
  }

  #make({ story, index, finding }) {
    const where = finding.waypoint === null ? "" : `waypoint ${finding.waypoint} · `;
    const place = `${where}${story.timeOf(finding.at_s)}`;
    const whose = this.stories.length > 1 ? [badge(index + 1), " "] : [];
    const [number, found] = [element("span", { class: "number" }), element("bdi")];
    const [seen, note] = [element("span", { class: "when" }), element("bdi", { class: "when" })];
    const when = element("span", { class: "when place" }, ...whose, place);
    const words = element("span", { class: "words" }, number, " ", found, when, seen, note);
    const button = element("button", { type: "button", tabindex: "-1", title: "Show its moment, its photo and its place" });
    const source = this.#cropOf(finding);
    button.append(picture(source), words);
    button.addEventListener("click", () => this.select(story, finding));
    const item = element("li", {}, button);
    item.classList.toggle("later", finding.index >= (this.#counts.get(story) ?? 0));
    const say = () => {
      const verdict = finding.review?.verdict ?? "open";
      write(number, String(finding.no));
      write(found, wordsOf({ ...finding, score: finding.surest ?? undefined }));
      write(seen, seenOften(finding, verdict));
      write(note, finding.review?.note ?? "");
      item.classList.toggle("rejected", verdict === "rejected");
    };
    return { item, say, story, finding, source, log: this.log + index };
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
    if (this.#focuses) (this.#items.get(this.#target?.finding.no)?.item.firstElementChild ?? this.choice.sort).focus();
    this.#focuses = false;
    const item = this.#items.get(current?.no)?.item;
    if (current === this.#current && item === this.#pointed) return;
    this.#pointed?.removeAttribute("aria-current");
    [this.#current, this.#pointed] = [current, item];
    if (!item) return;
    item.setAttribute("aria-current", "true");
    this.#rove(item.firstElementChild);
    const [top, bottom] = [item.offsetTop, item.offsetTop + item.offsetHeight];
    const { scrollTop, clientHeight } = this.scroller;
    if (top < scrollTop || bottom > scrollTop + clientHeight) this.scroller.scrollTop = top - clientHeight / 2;
  }
}

// How often an object was seen, how far from its place it may lie, and what was decided about it.
function seenOften({ sightings, error_m: errorM }, verdict) {
  const often = sightings > 1 ? `seen ${sightings} times` : "";
  const decided = { accepted: "✓ accepted", rejected: "✕ rejected" }[verdict];
  return [often, errorM == null ? "" : `± ${errorM.toFixed(1)} m`, decided].filter(Boolean).join(" · ");
}

export function picture(source) {
  const frame = element("span", { class: "thumb" });
  if (!source) return frame;
  const image = element("img", { alt: "", width: WIDE_PX, height: HIGH_PX });
  image.addEventListener("error", () => image.remove());
  loadSeen(image, source);
  frame.append(image);
  return frame;
}

function downloads() {
  const files = filesOfFindings();
  const links = files.map(([name, address]) => element("li", {}, element("a", { href: address, download: name }, name)));
  const menu = element("details", { class: "downloads" }, element("summary", { "aria-keyshortcuts": "e" }, "Download ", keyOf("e")), element("ul", {}, ...links));
  menu.hidden = !files.length;
  return menu;
}
