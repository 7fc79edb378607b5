// The calls so far that took longest beyond what was expected of the best place for them; a click goes to one.

import { told } from "./clock.js";
import { card, element } from "./element.js";

const MOST = 5;

export class WorstCalls {
  #count = 0;

  constructor(picked) {
    this.picked = picked;
    this.list = element("ol");
    this.element = card("Worst calls", this.list);
    this.element.classList.add("worst");
    this.element.hidden = true;
  }

  show(moment) {
    const count = moment.count("call");
    if (count === this.#count) return;
    this.#count = count;
    const lost = moment.story.call.slice(0, count).filter((call) => call.lost_s > 0);
    const worst = lost.sort((one, other) => other.lost_s - one.lost_s).slice(0, MOST);
    this.element.hidden = !worst.length;
    this.list.replaceChildren(...worst.map((call) => this.#item(call, moment.story)));
  }

  clear() {
    this.#count = 0;
    this.list.replaceChildren();
    this.element.hidden = true;
  }

  #item(call, story) {
    const where = call.waypoint === null ? "start" : `waypoint ${call.waypoint}`;
    const button = element("button", { type: "button" }, `${where}, ${told(story.missionS(call.at_s))}`);
    button.addEventListener("click", () => this.picked(call));
    const lost = element("strong", {}, `${call.lost_s.toFixed(1)} s lost:`);
    return element("li", {}, button, element("span", {}, lost, ` ${call.words[0] ?? ""}`));
  }
}
