// Each server: its state in a word and a colour, why, how far away it is, and the states it was in so far.

import { card, element, table, write } from "./element.js";

export class ServerList {
  #rows = new Map();

  constructor(places) {
    this.places = places;
    this.body = element("tbody");
    this.element = card("Servers", table(["server", "state", "away", "calls"], this.body, { class: "servers" }));
  }

  show(moment) {
    const servers = moment.story.servers;
    if (servers.length !== this.#rows.size) this.#begin(servers);
    const position = moment.position;
    const { places } = moment.calls;
    for (const [server, row] of this.#rows) {
      const step = moment.step(server);
      row.state.className = `state ${step?.tone ?? "aside"}`;
      write(row.state, step?.state ?? "AVL");
      write(row.means, step ? [step.means, step.why].filter(Boolean).join(": ") : "available");
      write(row.away, away(moment.story.plan?.ranges[server], position));
      write(row.calls, String(places.get(server) ?? 0));
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
}

function away(range, position) {
  if (!range || !position) return "";
  const [east, north, radius] = range;
  const metres = Math.hypot(position.east_m - east, position.north_m - north);
  return `${metres.toFixed(0)} m${metres <= radius ? ", in range" : ""}`;
}
