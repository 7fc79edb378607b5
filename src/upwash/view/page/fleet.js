// Several drones on the page: one map and a list of all of them, and everything about the one in focus.

import { badge } from "./badge.js";
import { DroneList } from "./drones.js";
import { element } from "./element.js";
import { Findings } from "./findings.js";
import { Flight } from "./flight.js";
import { FlightMap } from "./map.js";

export class Fleet {
  #focus = 0;

  constructor(stories, { places, tiles, picked, desk, changed }) {
    this.stories = stories;
    this.changed = changed;
    const chosen = (index) => this.focus(index);
    this.list = new DroneList(stories, chosen);
    this.map = new FlightMap("all drones", { places, tiles, logs: [...stories.keys()], chosen });
    const found = (story, finding) => {
      this.focus(stories.indexOf(story));
      picked(story, finding);
    };
    this.findings = new Findings(stories, "all drones", { picked: found, desk, changed });
    this.map.found = (story, finding) => this.findings.select(story, finding);
    const shared = { places, picked, findings: this.findings };
    this.flights = stories.map((story, log) => new Flight(story, log, { ...shared, sign: [badge(log + 1), " "] }));
    const flights = this.flights.map((flight) => flight.element);
    this.element = element("div", { class: "fleet" }, this.list.element, this.map.element, ...flights, this.findings.element);
    this.#showFocus();
  }

  // What the buttons step through.
  get watched() {
    return this.stories[this.#focus];
  }

  get number() {
    return this.#focus + 1;
  }

  focus(index) {
    if (index >= this.stories.length || index === this.#focus) return;
    this.#focus = index;
    this.#showFocus();
    this.changed();
  }

  #showFocus() {
    this.flights.forEach((flight, index) => (flight.element.hidden = index !== this.#focus));
    this.list.focus(this.#focus);
    this.map.focus(this.#focus);
  }

  show(clockS, limits) {
    const moments = this.stories.map((story) => story.at(clockS));
    this.list.show(moments);
    const current = this.findings.show(moments, this.#focus);
    this.flights[this.#focus].show(clockS, limits, current);
    this.map.show(moments, current);
  }

  restyle() {
    this.map.restyle();
    for (const flight of this.flights) flight.restyle();
  }

  summarize(summaries) {
    for (const flight of this.flights) flight.summarize(summaries);
  }
}
