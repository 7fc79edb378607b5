// Every call so far as a table, for those who read numbers and for those who cannot see figures.

import { element, scrolled, table } from "./element.js";
import { nameOf } from "./places.js";

const HEADS = ["waypoint", "ended at", "operation", "place", "delay", "waited", "why"];

export class CallTable {
  #moment = null;

  constructor(name) {
    this.body = element("tbody");
    const calls = scrolled(table(HEADS, this.body), `Calls by waypoint, ${name}`);
    this.element = element("details", {}, element("summary", {}, "The calls as a table"), calls);
    this.element.addEventListener("toggle", () => this.#moment && this.show(this.#moment));
  }

  show(moment) {
    this.#moment = moment;
    const count = this.element.open ? moment.count("call") : 0;
    const rows = this.body.rows;
    while (rows.length > count) rows[rows.length - 1].remove();
    if (rows.length < count) {
      const calls = moment.story.call.slice(rows.length, count);
      this.body.append(...calls.map((call) => row(call, moment.story.timeOf(call.at_s))));
    }
  }

  clear() {
    this.body.replaceChildren();
  }
}

function row(call, ended) {
  const cells = [
    ended,
    call.operation,
    nameOf(call.place),
    `${call.delay_s.toFixed(2)} s`,
    call.wait ? `${call.waited_s.toFixed(2)} s, ${call.wait}` : "",
    call.words.at(-1) ?? "",
  ];
  const waypoint = element("th", { scope: "row" }, call.waypoint === null ? "start" : String(call.waypoint));
  return element("tr", {}, waypoint, ...cells.map((cell) => element("td", {}, cell)));
}
