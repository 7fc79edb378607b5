// One flight on the page: all the parts that show it.

import { CallTable } from "./calls.js";
import { DelayChart } from "./chart.js";
import { element, write } from "./element.js";
import { Journal } from "./journal.js";
import { FlightMap } from "./map.js";
import { PhotoCard } from "./photo.js";
import { nameOf } from "./places.js";
import { ServerList } from "./servers.js";

export class Flight {
  #run = 0;
  #legend = "";

  constructor(story, log, places, picked) {
    this.story = story;
    this.places = places;
    const { name } = story;
    this.heading = element("h2", {}, name);
    this.doing = element("p", { class: "doing", role: "status" });
    this.totals = element("p", { class: "totals" });
    this.summary = element("p", { class: "summary", hidden: "" });
    this.trouble = element("p", { class: "trouble", role: "alert", hidden: "" });
    this.where = element("p", { class: "where" });
    this.decision = element("h3");
    this.reasons = element("ul", { class: "reasons" });
    this.legend = element("p", { class: "legend" });
    this.map = new FlightMap(name, places);
    this.chart = new DelayChart(name, places, picked);
    this.servers = new ServerList(places);
    this.photo = new PhotoCard(log);
    this.calls = new CallTable(name);
    this.journal = new Journal(name);
    const now = element("section", { class: "card now" }, this.decision, this.reasons);
    const chart = element("section", { class: "card delays" }, element("h3", {}, "Call delay by waypoint"), this.legend, this.chart.element, this.calls.element);
    this.element = element(
      "section",
      { class: "flight", "aria-label": `Flight ${name}` },
      element("div", { class: "head" }, this.heading, this.doing, this.totals, this.where, this.summary, this.trouble),
      this.map.element,
      element("div", { class: "side" }, now, this.servers.element, this.photo.element),
      chart,
      this.journal.element,
    );
  }

  show(missionS, limits) {
    if (this.story.run !== this.#run) this.#begin();
    const moment = this.story.at(missionS);
    this.#showHead(moment);
    this.#showDecision(moment);
    this.#showLegend();
    this.map.show(moment);
    this.chart.show(moment, limits);
    this.servers.show(moment);
    this.photo.show(moment);
    this.calls.show(moment);
    this.journal.show(moment);
  }

  #begin() {
    this.#run = this.story.run;
    this.calls.clear();
    this.journal.clear();
  }

  restyle(missionS) {
    this.map.restyle(this.story.at(missionS));
    this.chart.restyle();
  }

  summarize(words) {
    this.summary.hidden = !words;
    write(this.summary, words ?? "");
  }

  #showHead(moment) {
    const { story } = this;
    const doing = moment.last("doing");
    const over = story.ended && moment.atS >= story.ended.at_s;
    const ending = story.ended?.completed ? "mission completed" : "mission ended early";
    write(this.doing, over ? ending : (doing?.words ?? "waiting for the log to begin"));
    const policy = story.began ? `policy ${story.began.policy}` : "";
    const reached = `${doing?.reached ?? 0} of ${story.waypoints} waypoints reached`;
    write(this.totals, [reached, this.#counts(moment), policy].filter(Boolean).join(" · "));
    const at = moment.position;
    const metres = at && `${at.east_m.toFixed(0)} m east, ${at.north_m.toFixed(0)} m north, ${at.altitude_m.toFixed(0)} m up`;
    write(this.where, at ? [metres, this.map.degrees(at.east_m, at.north_m)].filter(Boolean).join(" · ") : "");
    this.trouble.hidden = !story.trouble;
    write(this.trouble, story.trouble);
  }

  #counts(moment) {
    const counts = new Map();
    let waits = 0;
    const count = moment.count("call");
    for (let index = 0; index < count; index += 1) {
      const call = this.story.call[index];
      counts.set(call.place, (counts.get(call.place) ?? 0) + 1);
      waits += call.wait ? 1 : 0;
    }
    const places = [...counts].sort().map(([place, number]) => `${number} on ${place === "local" ? "the drone" : place}`);
    return `${count} calls${places.length ? `: ${places.join(", ")}` : ""}${waits ? `, ${waits} waited` : ""}`;
  }

  #showDecision(moment) {
    const [decision, call] = [moment.last("decision"), moment.last("call")];
    const over = call && (!decision || call.at_s >= decision.at_s);
    const about = over ? call : decision;
    if (!about) {
      write(this.decision, "No call was decided yet");
      this.reasons.replaceChildren();
      return;
    }
    const where = about.waypoint === null ? "before the first waypoint" : `at waypoint ${about.waypoint}`;
    write(this.decision, `${over ? "Last call" : "Call under way"}: ${about.operation} ${where}`);
    const waited = over && call.wait ? `, ${call.waited_s.toFixed(2)} s of it waited` : "";
    const ran = over ? [`It ran on ${call.place === "local" ? "the drone" : nameOf(call.place)}: ${call.delay_s.toFixed(2)} s${waited}.`] : [];
    const words = [...ran, ...about.words];
    if (words.join("\n") === [...this.reasons.children].map((item) => item.textContent).join("\n")) return;
    this.reasons.replaceChildren(...words.map((each) => element("li", {}, each)));
  }

  #showLegend() {
    const all = ["local", ...this.story.servers];
    if (all.join() === this.#legend) return;
    this.#legend = all.join();
    const entries = all.map((place) => element("span", { class: "entry" }, this.places.icon(place), nameOf(place)));
    const wait = element("span", { class: "entry" }, element("span", { class: "wait", "aria-hidden": "true" }), "waited for a server");
    const mean = element("span", { class: "entry" }, element("span", { class: "mean", "aria-hidden": "true" }), "mean on the drone");
    this.legend.replaceChildren(...entries, wait, mean);
  }
}

