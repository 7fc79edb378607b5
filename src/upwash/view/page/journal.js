// What happened, newest first.

import { card, element, scrolled } from "./element.js";

const MOST = 100; // lines

export class Journal {
  #from = 0; // of the lines shown, the first and the one after the last
  #to = 0;
  #began = null; // from which the times of the lines are counted

  constructor(name) {
    this.list = element("ol", { class: "journal", reversed: "" });
    this.element = card("What happened", scrolled(this.list, `What happened, ${name}`, "scroll lines"));
  }

  show(moment) {
    const to = moment.count("said");
    const from = Math.max(0, to - MOST);
    if (to < this.#to || from > this.#to || this.#began !== moment.story.began) {
      this.#began = moment.story.began;
      this.list.replaceChildren();
      this.#from = this.#to = from;
    }
    for (; this.#to < to; this.#to += 1) this.list.prepend(line(moment.story.said[this.#to], moment.story));
    for (; this.#from < from; this.#from += 1) this.list.lastElementChild.remove();
  }

  clear() {
    this.list.replaceChildren();
    this.#from = this.#to = 0;
  }
}

function line(said, story) {
  const day = story.timeOfDay(said.at_s);
  const time = element("span", { class: "at" }, story.timeOf(said.at_s), ...(day ? [" ", element("time", {}, day)] : []));
  return element("li", { class: said.tone }, time, said.words);
}
