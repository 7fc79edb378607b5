// Each server: its state in a word and a colour, why, how far away it is (bold in its range), its calls, and what these saved. Many scroll.

import { lasting } from "./clock.js";
import { card, element, scrolled, table, write } from "./element.js";
import { inBrief } from "./places.js";

const NAME = 12; // characters; all of it is shown where it is pointed at

const EARTH_M = 2.1e7; // as far as one can be from anything

export class ServerList {
  #rows = new Map();
  #servers = null;

  constructor(places, name) {
    this.places = places;
    this.body = element("tbody");
    const list = table(["server", "state", "away", "calls", "saved"], this.body, { class: "servers" });
    this.more = element("p", { class: "note" });
    this.about = element("p", { class: "note" });
    this.element = card("Servers", scrolled(list, `Servers, ${name}`, "scroll many"), this.more, this.about);
  }

  show(moment) {
    const servers = moment.story.servers;
    if (servers !== this.#servers) this.#begin(servers);
    const more = moment.story.known.size - servers.length;
    write(this.more, more ? `The log has ${more} servers more, which the page does not show.` : "");
    const position = moment.position;
    const { places } = moment.calls;
    for (const [server, row] of this.#rows) {
      const step = moment.step(server);
      row.state.className = `state ${step?.tone ?? "aside"}`;
      write(row.state, step?.state ?? "not joined");
      write(row.why, step?.why ?? "");
      row.why.title = step?.why ?? ""; // a line has no room for all
      const [words, isInside] = away(moment.story.plan?.ranges.get(server), position);
      write(row.away, words);
      write(row.inside, isInside ? ", in range" : "");
      row.away.classList.toggle("inside", isInside);
      const calls = places.get(server) ?? 0;
      const saved = moment.savedAt(server);
      write(row.calls, String(calls));
      write(row.saved, saved === null ? (calls ? "?" : "") : lasting(saved));
    }
    write(this.about, whatIsSaved(moment));
  }

  #begin(servers) {
    this.#servers = servers;
    this.#rows.clear();
    this.body.replaceChildren();
    for (const server of servers) {
      const row = {
        state: element("span"), why: element("span", { class: "means" }), away: element("span"), inside: element("span", { class: "unseen" }), calls: element("td"), saved: element("td"),
      };
      const name = element("th", { scope: "row", title: server }, this.places.icon(server), ` ${inBrief(server, NAME)}`);
      const state = element("td", {}, element("div", {}, row.state, " ", row.why));
      this.body.append(element("tr", {}, name, state, element("td", {}, row.away, row.inside), row.calls, row.saved));
      this.#rows.set(server, row);
    }
  }
}

// Against what the column counts, or why it cannot.
function whatIsSaved(moment) {
  if (moment.count("going")) return "What a server saved is not known: the drone flew on before answers.";
  if (!moment.localDelays.size && moment.calls.count) return "What a server saved is not known before a call has run on the drone.";
  return "Saved: against the mean delay of such calls on the drone so far, without those that fell back.";
}

function away(range, position) {
  if (!range || !position) return ["", false];
  const [east, north, radius] = range;
  const metres = Math.hypot(position.east_m - east, position.north_m - north);
  return [lengthOf(metres), metres <= radius];
}

function lengthOf(metres) {
  if (metres > EARTH_M) return "not on Earth";
  return metres < 10_000 ? `${metres.toFixed(0)} m` : `${(metres / 1000).toFixed(0)} km`;
}
