// Every call so far as a table, for those who read numbers and for those who cannot see figures.

import { card, element, scrolled, table } from "./element.js";
import { nameOf, titleOf } from "./places.js";

const HEADS = ["waypoint", "ended at", "operation", "place", "delay", "waited", "why"];

export class CallTable {
  #operations = [];

  constructor(name, places) {
    this.places = places;
    this.body = element("tbody");
    this.element = card("All calls", scrolled(table(HEADS, this.body, { class: "calls-table" }), `Calls by waypoint, ${name}`, "scroll many"));
  }

  // Where it is to be seen.
  show(moment) {
    const { operations } = this.places;
    if (operations !== this.#operations) this.clear();
    this.#operations = operations;
    const count = this.element.offsetParent ? moment.count("call") : 0;
    const rows = this.body.rows;
    while (rows.length > count) rows[rows.length - 1].remove();
    if (rows.length < count) {
      const calls = moment.story.call.slice(rows.length, count);
      this.body.append(...calls.map((call) => row(call, moment.story.timeOf(call.at_s), operations)));
    }
  }

  clear() {
    this.body.replaceChildren();
  }
}

function row(call, ended, operations) {
  const cells = [
    ended,
    titleOf(call.operation, operations),
    nameOf(call.place),
    `${call.delay_s.toFixed(2)} s`,
    call.wait ? `${call.waited_s.toFixed(2)} s, ${call.wait}` : "",
    call.words.at(-1) ?? "",
  ];
  const waypoint = element("th", { scope: "row" }, call.waypoint === null ? "start" : String(call.waypoint));
  return element("tr", {}, waypoint, ...cells.map((cell) => element("td", {}, cell)));
}
