// The stories as they come from the server or are in the document.

import { Desk } from "./desk.js";
import { Story } from "./story.js";

const LOST = "The connection to the program behind this page is lost; trying again.";
const ENDED = "The program behind this page has ended. What it told is still here; upwash view shows the log again.";

export class Feed {
  #hear;
  #desk;

  constructor({ opened, grown, summarized, said }) {
    this.stories = [];
    this.said = said;
    this.#hear = {
      page: (page) => {
        if (this.stories.length === 0) {
          this.stories = page.logs.map((name) => new Story(name));
          this.#desk = new Desk(page);
          opened(this.stories, page, this.#desk);
        } else this.#desk.renew(page);
        said("");
      },
      facts: (batch) => {
        this.stories[batch.log].take(batch);
        grown();
      },
      findings: (found) => {
        found.forEach((each, log) => this.stories[log].number(each));
        grown();
      },
      summaries: summarized,
      elsewhere: (told) => {
        for (const [log, others] of Object.entries(told)) this.stories[log].others = others.map((other) => this.#callsOf(other));
        grown();
      },
      end: () => {
        for (const story of this.stories) story.isBehind = story.grows = false;
        this.#desk.end();
        grown();
      },
    };
  }

  // The calls of another policy, of a flight on this page or flown for it.
  #callsOf({ policy, log, calls = [] }) {
    const made = calls.map(([place, delay_s]) => ({ place, delay_s }));
    return log === undefined ? { name: policy, calls: made } : { name: `${policy} (${this.stories[log].name})`, calls: this.stories[log].call };
  }

  start() {
    const told = document.getElementById("told");
    if (told) for (const [kind, data] of JSON.parse(told.textContent)) this.#hear[kind](data);
    else this.#listen(new EventSource("events"));
  }

  #listen(source) {
    for (const [kind, hear] of Object.entries(this.#hear)) {
      source.addEventListener(kind, (message) => hear(JSON.parse(message.data)));
    }
    source.addEventListener("end", () => {
      source.close();
      this.said(ENDED);
    });
    source.addEventListener("error", () => this.said(LOST));
  }
}
