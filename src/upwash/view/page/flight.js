// One flight on the page: all the parts that show it, with a map of its own where it shares none.

import { aboutFlight } from "./about.js";
import { CallTable } from "./calls.js";
import { DelayChart } from "./chart.js";
import { DecisionCard } from "./decision.js";
import { card, counted, element, unparted, write } from "./element.js";
import { Findings } from "./findings.js";
import { degrees } from "./ground.js";
import { Journal } from "./journal.js";
import { Lanes } from "./lanes.js";
import { PhotoCard } from "./photo.js";
import { outlook } from "./outlook.js";
import { FILL_WORDS, byName, nameOf, theNameOf } from "./places.js";
import { ServerList } from "./servers.js";
import { WorstCalls } from "./worst.js";

export class Flight {
  #run = 0;
  #legend = "";

  constructor(story, log, { places, picked, desk, changed, map = null, findings = null, sign = [] }) {
    this.story = story;
    this.log = log;
    this.places = places;
    this.map = map;
    const { name } = story;
    this.heading = element("h2", {}, ...sign, name);
    this.about = element("p", { class: "about" });
    this.totals = element("p", { class: "totals" });
    this.summary = element("p", { class: "summary", hidden: "" });
    this.outlook = element("p", { class: "outlook" });
    this.trouble = element("p", { class: "trouble", role: "alert", hidden: "" });
    this.where = element("p", { class: "where" });
    this.decision = new DecisionCard(places);
    this.legend = element("p", { class: "legend" });
    this.chart = new DelayChart(name, places, (call) => picked(story, call));
    this.lanes = new Lanes(name, places, (clockS) => picked(story, { at_s: clockS + story.zeroS }));
    this.servers = new ServerList(places, name);
    this.own = findings ? null : new Findings([story], name, { log, picked, desk, changed });
    this.findings = findings ?? this.own;
    const select = (each, finding) => this.findings.select(each, finding);
    this.photo = new PhotoCard(log, (finding) => select(story, finding));
    if (map) map.found = select;
    this.calls = new CallTable(name);
    this.journal = new Journal(name);
    this.worst = new WorstCalls((call) => picked(story, call));
    const delays = card("Call delay by waypoint", this.legend, this.chart.element, this.worst.element, this.calls.element);
    delays.classList.add("delays");
    const words = [this.totals, this.where, this.summary, this.trouble];
    this.element = element(
      "section",
      { class: "flight", "aria-label": `Flight ${name}` },
      element("div", { class: "head" }, this.heading, this.about, this.outlook, ...words),
      ...(map ? [map.element] : []),
      this.photo.element,
      ...(this.own ? [this.own.element] : []),
      element("div", { class: "side" }, this.decision.element, this.servers.element),
      this.lanes.element,
      delays,
      this.journal.element,
    );
  }

  get stories() {
    return [this.story];
  }

  // What the buttons step through.
  get watched() {
    return this.story;
  }

  // What has a size of its own comes first, and what is drawn into the rest of the page last.
  show(clockS, limits, current = null) {
    if (this.story.run !== this.#run) this.#begin();
    const moment = this.story.at(clockS);
    this.#showHead(moment);
    this.decision.show(moment);
    this.worst.show(moment);
    this.#showLegend();
    this.servers.show(moment);
    const finding = this.own ? this.own.show([moment]) : current;
    this.photo.show(moment, finding);
    this.calls.show(moment);
    this.journal.show(moment);
    this.map?.show([moment], finding);
    this.chart.show(moment, limits);
    this.lanes.show(moment);
  }

  #begin() {
    this.#run = this.story.run;
    this.chart.clear();
    this.lanes.clear();
    this.calls.clear();
    this.worst.clear();
    this.journal.clear();
  }

  // What is shown next is drawn anew, in other colours.
  restyle() {
    this.map?.restyle();
    this.chart.clear();
    this.lanes.clear();
  }

  summarize(summaries) {
    write(this.summary, summaries[this.log] ?? "");
  }

  #showHead(moment) {
    const { story } = this;
    write(this.about, aboutFlight(moment));
    write(this.outlook, unparted(outlook(moment).join(" · ")));
    write(this.totals, this.#calls(moment));
    write(this.where, this.#where(moment.position));
    this.summary.hidden = !moment.isOver || !this.summary.textContent;
    this.trouble.hidden = !story.trouble;
    write(this.trouble, story.trouble);
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
    const sign = (style) => element("span", { class: style, "aria-hidden": "true" });
    const entries = [
      ...all.map((place) => [places.icon(place), nameOf(place)]),
      ...operations.map((operation) => [places.icon("local", operation), fillOf(places, operation)]),
      [sign("wait"), "waited for a server"],
      [sign("mean"), "mean on the drone"],
      ...(story.open.length ? [[sign("open"), "answer not there"]] : []),
      ...(found ? [[pill("1"), "what was found, by its number"], [pill("×9"), "several close together"]] : []),
    ];
    this.legend.replaceChildren(...entries.map((entry) => element("span", { class: "entry" }, ...entry)));
  }
}

function fillOf(places, operation) {
  return `${FILL_WORDS[places.fill(operation)]}: ${operation}`;
}

function pill(words) {
  return element("span", { class: "pill", "aria-hidden": "true" }, words);
}
