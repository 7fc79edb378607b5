// All flights that the page shows: one map, the lanes, a tab for each part, and one flight in focus.

import { behindS, inWords } from "./apart.js";
import { badge } from "./badge.js";
import { Dock } from "./dock.js";
import { DroneList } from "./drones.js";
import { write } from "./element.js";
import { Findings } from "./findings.js";
import { Flight } from "./flight.js";
import { FlightMap } from "./map.js";

const on = (id) => document.getElementById(id);

export class Flights {
  #focus = 0;

  // Of these logs' stories, whose first is of that `log`; `together` says that they are of several drones.
  constructor(stories, log, { places, lanes, tiles, picked, desk, changed, together }) {
    Object.assign(this, { stories, lanes, changed, together });
    const many = stories.length > 1;
    const all = together ? "drones" : "flights";
    const logs = stories.map((_, index) => log + index);
    const chosen = (index) => this.focus(index);
    const found = (story, finding) => {
      this.focus(stories.indexOf(story));
      picked(story, finding);
    };
    const shared = together ? new Findings(stories, "all drones", { log, picked: found, desk, changed }) : null;
    this.flights = stories.map((story, index) => {
      const sign = many ? [badge(index + 1), " "] : [];
      return new Flight(story, logs[index], { places, picked: found, desk, changed, findings: shared, sign });
    });
    this.list = many ? new DroneList(stories, chosen, together ? "Drones" : "Flights") : null;
    this.map = new FlightMap(many ? "all flights" : stories[0].name, { places, tiles, logs, chosen });
    this.map.found = (story, finding) => {
      this.dock.open("findings");
      this.flights[stories.indexOf(story)].findings.select(story, finding);
    };
    this.dock = new Dock([...(many ? [all] : []), "now", "findings", "servers", "why"], on("hide"), changed);
    if (many) {
      this.dock.fill({ [all]: [this.list.element] });
      this.map.element.append(this.list.chips);
    }
    this.elements = [this.map.element, this.dock.element];
    this.#showFocus();
  }

  // The one in focus, which the buttons step through.
  get watched() {
    return this.stories[this.#focus];
  }

  // Its number, where there are several.
  get number() {
    return this.stories.length > 1 ? this.#focus + 1 : 0;
  }

  get findings() {
    return this.flights[this.#focus].findings;
  }

  focus(index) {
    if (index >= this.stories.length || index === this.#focus) return;
    this.#focus = index;
    this.#showFocus();
    this.changed();
  }

  #showFocus() {
    this.dock.fill(this.flights[this.#focus].parts);
    this.list?.focus(this.#focus);
    this.map.focus(this.#focus);
  }

  show(clockS, endS) {
    const moments = this.stories.map((story) => story.at(clockS));
    const mine = this.together ? moments : [moments[this.#focus]];
    const current = this.findings.show(mine, this.together ? this.#focus : 0);
    const apart = this.#apart(clockS);
    this.list?.show(moments, apart);
    write(on("apart"), apart.filter(Boolean).join(", "));
    this.flights[this.#focus].show(moments[this.#focus], current);
    this.dock.count("findings", this.findings.count);
    this.map.show(moments, current, this.together ? null : this.#focus);
    this.lanes.show(moments[this.#focus], this.together ? [] : moments, endS);
    return moments;
  }

  // How far each flight is behind the first, in words; drones of a fleet are not held against each other.
  #apart(clockS) {
    const [first] = this.stories;
    return this.stories.map((story) => (this.together || story === first ? "" : inWords(behindS(first, story, clockS), first, story)));
  }

  restyle() {
    this.map.restyle();
    this.lanes.clear();
  }

  summarize(summaries) {
    for (const flight of this.flights) flight.summarize(summaries);
  }
}
