// The state of a flight for a person who looks for half a second: who has the vehicle, what it does, and how it is.

import { told } from "./clock.js";
import { badge } from "./badge.js";
import { courseOf } from "./decision.js";
import { counted, drawn, element, unparted, write } from "./element.js";
import { STALE_S } from "./story.js";

const LOW_PERCENT = 30; // of a battery whose vehicle does not tell its own stages
const CRITICAL_PERCENT = 20;
const WEAK_FIXES = new Set(["none", "2d"]);

export class Bar {
  constructor(name) {
    this.sign = element("span", { class: "sign" });
    this.who = element("strong", { class: "who" });
    this.words = element("span", { class: "doing", role: "status" });
    this.passing = element("span"); // what changes all the time, which no screen reader should read all the time
    this.aside = element("p", { class: "aside" });
    this.tiles = new Map(["battery", "link", "GPS", "mode", "motors"].map((tile) => [tile, new Tile(tile)]));
    this.progress = element("progress", { max: "1", value: "0", "aria-label": `Waypoints reached, ${name}` });
    this.element = element(
      "section",
      { class: "bar", "aria-label": `State of ${name}` },
      element("div", { class: "says" }, element("p", {}, this.sign, this.who, this.words, this.passing), this.aside),
      element("dl", { class: "tiles" }, ...[...this.tiles.values()].map((tile) => tile.element)),
      this.progress,
    );
  }

  // `name` is the drone's, of several, and `number` its number on their map.
  show(moment, name, number = "") {
    if (this.sign.textContent !== String(number)) this.sign.replaceChildren(...(number ? [badge(number)] : []));
    if (moment.withoutNewsS && !moment.silence) this.#showSilence(moment, name);
    else this.#showState(moment, name);
    const { story, reached } = moment;
    this.progress.hidden = !story.waypoints;
    this.progress.value = story.waypoints ? reached / story.waypoints : 0;
  }

  #showSilence(moment, name) {
    const doing = moment.last("doing");
    const words = moment.underWay?.doing || inWords(moment);
    const before = doing ? `${moment.story.timeOf(moment.atS)} last heard: ${[doing.who, words].filter(Boolean).join(" · ")}` : "";
    this.element.className = "bar alarm";
    write(this.who, "NO NEWS");
    write(this.words, "");
    write(this.passing, `for ${told(moment.withoutNewsS)}`);
    write(this.aside, [name, before].filter(Boolean).join(" · "));
    for (const tile of this.tiles.values()) tile.element.hidden = true;
  }

  #showState(moment, name) {
    const doing = moment.last("doing");
    const calling = moment.open.length ? null : moment.underWay; // a drone that flies on does not wait for a call
    this.element.className = `bar ${doing?.tone ?? "ground"}${calling ? " calling" : ""}`;
    write(this.who, doing?.who ?? "WAITING");
    write(this.words, calling ? calling.doing : inWords(moment));
    write(this.passing, unparted((calling ? [courseOf(calling, moment)] : figures(moment, doing)).filter(Boolean).join(" · ")));
    this.words.classList.toggle("alone", !calling && Boolean(this.passing.textContent));
    write(this.aside, unparted([name, ...beside(moment, doing, calling)].filter(Boolean).join(" · ")));
    this.#showTiles(moment);
  }

  #showTiles(moment) {
    const { story } = moment;
    const lost = moment.silence;
    const known = lost ? {} : (moment.last("vehicle") ?? {}); // what a vehicle told that is not heard any more is old
    const battery = lost ? null : moment.last("battery");
    const heard = moment.isOver || !story.opened ? null : moment.recent("fix", STALE_S);
    this.tiles.get("battery").showBattery(battery?.battery_percent, moment.stages);
    const silent = lost && told(moment.atS - lost.since_s);
    this.tiles.get("link").show(lost ? `lost ${silent}` : heard ? "ok" : "", { tone: lost ? "critical" : "" });
    const satellites = known.satellites === undefined ? "" : ` · ${known.satellites}`;
    this.tiles.get("GPS").show(known.gps ? `${known.gps.replace("rtk-", "RTK ").replace("fixed", "fix")}${satellites}` : "", {
      tone: WEAK_FIXES.has(known.gps) ? "critical" : "",
    });
    this.tiles.get("mode").show(known.mode ?? "");
    this.tiles.get("motors").show({ true: "armed", false: "off" }[known.armed] ?? "");
  }
}

class Tile {
  constructor(name) {
    this.value = element("span");
    this.charge = drawn("rect", { x: 2.5, y: 3.5, height: 9, width: 0 });
    const outline = drawn("path", { d: "M1 2H23V14H1ZM23 5.5H26V10.5H23", fill: "none", stroke: "currentColor", "stroke-width": 2 });
    this.icon = drawn("svg", { viewBox: "0 0 27 16", width: 34, height: 20, "aria-hidden": "true" }, this.charge, outline);
    this.element = element("div", { hidden: "" }, element("dt", {}, name), element("dd", {}, this.value));
  }

  show(words, { tone = "" } = {}) {
    this.element.hidden = !words;
    this.element.className = tone;
    write(this.value, words);
  }

  showBattery(percent, stages) {
    const low = stages?.low_percent ?? LOW_PERCENT;
    const critical = stages?.critical_percent ?? Math.min(CRITICAL_PERCENT, low);
    const tone = percent < critical ? "critical" : percent < low ? "low" : "";
    this.show(percent === undefined ? "" : `${percent.toFixed(0)} %`, { tone });
    this.charge.setAttribute("width", (0.19 * Math.min(100, Math.max(0, percent ?? 0))).toFixed(1));
    if (!this.icon.parentNode) this.value.before(this.icon);
  }
}

// What the drone does; of a vehicle that the program does not fly, the mode that it is in.
export function inWords(moment) {
  const doing = moment.last("doing");
  if (!doing) return "waiting for the log to begin";
  if (moment.isOver && doing.tone === "ground") return moment.story.isCompleted ? "mission completed" : "mission ended early";
  const others = doing.tone === "person" || doing.who === "FAIL-SAFE";
  return doing.words || (others ? (moment.last("vehicle")?.mode ?? "") : "");
}

// How high it is, when it is on the ground, and what a fail-safe may be about.
function figures(moment, doing) {
  if (!doing || doing.tone === "ground" || moment.silence || moment.last("vehicle")?.armed === false) return [];
  const { position } = moment;
  const down = moment.isOver ? null : moment.recent("down", STALE_S);
  const battery = moment.last("battery")?.battery_percent;
  const isEmpty = doing.tone === "alarm" && battery < (moment.stages?.low_percent ?? LOW_PERCENT);
  return [
    position ? `${position.altitude_m.toFixed(0)} m` : "",
    down && doing.tone === "landing" ? `on the ground in ${told(down.down_s)}` : "",
    doing.tone === "program" && moment.open.length ? `${counted(moment.open.length, "answer")} open` : "",
    isEmpty ? `battery ${battery.toFixed(0)} %` : "",
  ];
}

// In small letters: when it is; since when another party has the vehicle; and of a flight of the program how far it is.
function beside(moment, doing, calling) {
  const { story } = moment;
  const atS = Math.min(moment.atS, story.ended?.at_s ?? Infinity); // beside a longer flight too
  const place = moment.position;
  const motion = moment.last("vehicle")?.armed === false ? null : moment.recent("motion", STALE_S);
  const others = doing && (doing.tone === "person" || doing.tone === "alarm");
  return [
    story.began ? story.timeOf(atS) : "",
    story.timeOfDay(atS),
    calling ? doing?.words : "",
    others ? `since ${story.timeOf(moment.heldSince)}` : "",
    story.waypoints ? `${moment.reached} of ${counted(story.waypoints, "waypoint")} reached` : "",
    calling && place ? `${place.altitude_m.toFixed(0)} m` : "",
    motion?.ground_speed_m_s >= 0.05 && doing?.tone !== "ground" ? `${motion.ground_speed_m_s.toFixed(1)} m/s` : "",
  ];
}
