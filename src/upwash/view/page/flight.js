// One flight on the page: the parts of it that the tabs beside the map show.

import { aboutFlight } from "./about.js";
import { CallTable } from "./calls.js";
import { DecisionCard } from "./decision.js";
import { card, counted, element, unparted, write } from "./element.js";
import { Findings } from "./findings.js";
import { degrees } from "./ground.js";
import { Journal } from "./journal.js";
import { PhotoCard } from "./photo.js";
import { outlook } from "./outlook.js";
import { FILL_WORDS, byName, nameOf, theNameOf, titleOf } from "./places.js";
import { ServerList } from "./servers.js";
import { WorstCalls } from "./worst.js";

const STATES = { aside: "in range", checking: "joining", ready: "ready", trouble: "left alone" }; // as the lanes have them

export class Flight {
  #run = 0;
  #legend = "";

  // `findings` are those of all flights together, where they are one list.
  constructor(story, log, { places, picked, desk, changed, findings = null, sign = [] }) {
    this.story = story;
    this.log = log;
    this.places = places;
    const { name } = story;
    this.heading = element("h2", { class: sign.length ? "" : "unseen" }, ...sign, name);
    this.about = element("p", { class: "about" });
    this.totals = element("p", { class: "totals" });
    this.summary = element("p", { class: "summary", hidden: "" });
    this.outlook = element("p", { class: "outlook" });
    this.where = element("p", { class: "where" });
    this.decision = new DecisionCard(places);
    this.legend = element("p", { class: "legend" });
    this.servers = new ServerList(places, name);
    this.findings = findings ?? new Findings([story], name, { log, picked, desk, changed });
    this.photo = new PhotoCard(log, (finding) => this.findings.select(story, finding));
    this.calls = new CallTable(name, places);
    this.journal = new Journal(name);
    this.worst = new WorstCalls((call) => picked(story, call));
    this.parts = {
      now: [this.heading, this.outlook, this.summary, this.decision.element, this.photo.element, this.where, this.totals, this.about],
      findings: [this.findings.element],
      servers: [this.servers.element, card("Marks and colours", this.legend)],
      why: [this.decision.why, this.worst.element, this.journal.element, this.calls.element],
    };
  }

  show(moment, current) {
    if (this.story.run !== this.#run) this.#begin();
    write(this.about, aboutFlight(moment));
    write(this.outlook, unparted(outlook(moment).join(" · ")));
    write(this.totals, this.#calls(moment));
    write(this.where, this.#where(moment.position));
    this.summary.hidden = !moment.isOver || !this.summary.textContent;
    this.decision.show(moment);
    this.worst.show(moment);
    this.#showLegend();
    this.servers.show(moment);
    this.photo.show(moment, current);
    this.calls.show(moment);
    this.journal.show(moment);
  }

  #begin() {
    this.#run = this.story.run;
    this.calls.clear();
    this.worst.clear();
    this.journal.clear();
  }

  summarize(summaries) {
    write(this.summary, summaries[this.log] ?? "");
  }

  #where(place) {
    if (!place) return "";
    const [east, north, up] = [place.east_m, place.north_m, place.altitude_m].map((metres) => metres.toFixed(0));
    const there = degrees(this.story.plan, place.east_m, place.north_m);
    return unparted([`${east} m east, ${north} m north, ${up} m up`, there?.replace(", ", ",\u00a0")].filter(Boolean).join(" · "));
  }

  #calls(moment) {
    const { count, places, waited } = moment.calls;
    const parts = [...places].sort(([one], [other]) => byName(one, other)).map(([place, number]) => `${number} on ${theNameOf(place)}`);
    const calls = `${counted(count, "call")}${parts.length ? `: ${parts.join(", ")}` : ""}${waited ? `, ${waited} waited` : ""}`;
    const [gone, turned, hiddenS] = [moment.count("going"), moment.count("turn"), moment.hiddenS];
    const went = [
      gone ? `gone on before ${counted(gone, "answer")}` : "",
      turned ? `turned back for ${turned}` : "",
      hiddenS >= 0.5 ? `${hiddenS.toFixed(0)} s hidden` : "",
      moment.isOver && moment.open.length ? `${counted(moment.open.length, "answer")} not there at the end` : "",
    ];
    return [calls, went.filter(Boolean).join(", ")].filter(Boolean).join(" · ");
  }

  #showLegend() {
    const { places, story } = this;
    const all = ["local", ...story.servers];
    const operations = places.operations.length > 1 ? [...story.operations].sort() : [];
    const found = story.told.length > 0;
    const key = JSON.stringify([all, places.operations, operations, found, story.open.length > 0]);
    if (key === this.#legend) return;
    this.#legend = key;
    const sign = (style, words = "") => element("span", { class: style, "aria-hidden": "true" }, words);
    const entries = [
      ...all.map((place) => [places.icon(place), nameOf(place)]),
      ...operations.map((operation) => [places.icon("local", operation), `${FILL_WORDS[places.fill(operation)]}: ${titleOf(operation, places.operations)}`]),
      [sign("wait"), "dark in a call: waited"],
      [sign("mean"), "mean on the drone"],
      ...(story.open.length ? [[sign("open"), "answer not there"]] : []),
      ...(found ? [[sign("pill", "1"), "what was found, by its number"], [sign("pill", "×9"), "several close together"]] : []),
      ...Object.entries(STATES).map(([tone, words]) => [element("span", { class: `state ${tone}` }, words)]),
    ];
    this.legend.replaceChildren(...entries.map((entry) => element("span", { class: "entry" }, ...entry)));
  }
}
