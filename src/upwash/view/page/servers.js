// Each server: its state in a word and a colour, why, how far away it is, and the states it was in so far.

import { element, write } from "./element.js";

export class ServerList {
  #rows = new Map();

  constructor(places) {
    this.places = places;
    this.body = element("tbody");
    const heads = ["server", "state", "away", "calls"].map((head) => element("th", { scope: "col" }, head));
    const table = element("table", { class: "servers" }, element("thead", {}, element("tr", {}, ...heads)), this.body);
    this.element = element("section", { class: "card" }, element("h3", {}, "Servers"), table);
  }

  show(moment) {
    const servers = moment.story.servers;
    if (servers.length !== this.#rows.size) this.#begin(servers);
    const position = moment.position;
    const counts = this.#counts(moment);
    for (const [server, row] of this.#rows) {
      const step = moment.step(server);
      row.state.className = `state ${step?.tone ?? "aside"}`;
      write(row.state, step?.state ?? "AVL");
      write(row.means, step ? [step.means, step.why].filter(Boolean).join(": ") : "available");
      write(row.away, away(moment.story.plan?.ranges[server], position));
      write(row.calls, String(counts.get(server) ?? 0));
    }
  }

  #begin(servers) {
    this.#rows.clear();
    this.body.replaceChildren();
    for (const server of servers) {
      const row = {
        state: element("span"), means: element("span", { class: "means" }), away: element("td"), calls: element("td"),
      };
      const name = element("th", { scope: "row" }, this.places.icon(server), ` ${server}`);
      this.body.append(element("tr", {}, name, element("td", {}, row.state, " ", row.means), row.away, row.calls));
      this.#rows.set(server, row);
    }
  }

  #counts(moment) {
    const counts = new Map();
    const count = moment.count("call");
    for (let index = 0; index < count; index += 1) {
      const { place } = moment.story.call[index];
      counts.set(place, (counts.get(place) ?? 0) + 1);
    }
    return counts;
  }
}

function away(range, position) {
  if (!range || !position) return "";
  const [east, north, radius] = range;
  const metres = Math.hypot(position.east_m - east, position.north_m - north);
  return `${metres.toFixed(0)} m${metres <= radius ? ", in range" : ""}`;
}
