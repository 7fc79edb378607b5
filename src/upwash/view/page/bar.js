// The state of a flight for a person who looks for half a second: who has the vehicle, what it does, and how it is.

import { told } from "./clock.js";
import { badge } from "./badge.js";
import { courseOf } from "./decision.js";
import { counted, drawn, element, unparted, write } from "./element.js";
import { STALE_S } from "./story.js";

const LOW_PERCENT = 30; // of a battery whose vehicle does not tell its own stages
const CRITICAL_PERCENT = 20;
const TONES = ["alarm", "person", "torn", "landing", "program", "ground"]; // of states, the worst first
const WEAK_FIXES = new Set(["none", "2d"]);

export class Bar {
  constructor() {
    this.sign = element("span", { class: "sign" });
    this.who = element("strong", { class: "who" });
    this.was = element("s", { class: "was" }); // who had the vehicle when it was heard last
    this.words = element("span", { class: "doing", role: "status" });
    this.passing = element("span"); // what changes all the time, which no screen reader should read all the time
    this.aside = element("span", { class: "aside" });
    this.tiles = new Map(["battery", "link", "GPS", "mode", "motors"].map((tile) => [tile, new Tile(tile)]));
    this.progress = element("progress", { max: "1", value: "0", "aria-label": "Waypoints reached" });
    this.element = element(
      "section",
      { class: "bar", "aria-label": "State" },
      element("div", { class: "says" }, element("p", {}, this.who, " ", this.was, this.words, this.passing), element("p", { class: "small" }, this.sign, this.aside)),
      element("dl", { class: "tiles" }, ...[...this.tiles.values()].map((tile) => tile.element)),
      this.progress,
    );
  }

  // A flight at its moment; with its `name` and number, of several. Of a fleet all moments are given, and this is the drone in focus.
  // Returns the state in a word.
  show(moment, name, fleet, number = "") {
    if (this.sign.textContent !== String(number)) this.sign.replaceChildren(...(number ? [badge(number)] : []));
    const one = saysOf(moment);
    const own = [one.who, joined([one.words, one.passing], one.calls ? "" : " · ")];
    const says = fleet.length > 1 ? { ...saysOfAll(fleet), small: [...own, ...one.small] } : one;
    this.element.className = `bar ${says.tone}${says.calls ? " calling" : ""}${says.isLed ? " led" : ""}`;
    write(this.who, says.who);
    write(this.was, says.was ?? "");
    write(this.words, says.words);
    write(this.passing, says.passing ?? "");
    this.words.classList.toggle("alone", !says.calls && Boolean(says.passing));
    write(this.aside, joined([name, ...says.small]));
    this.aside.title = this.aside.textContent; // a line has no room for all
    this.#showTiles(moment, one);
    const { story, reached } = moment;
    this.progress.hidden = !story.waypoints;
    this.progress.value = story.waypoints ? reached / story.waypoints : 0;
    return fleet.length > 1 ? byTone(fleet)[0].who : one.who;
  }

  // What the vehicle told last; of one that is not heard any more struck out, with its age.
  #showTiles(moment, { who }) {
    const { story } = moment;
    const lost = moment.silence;
    const silentS = who === "NO NEWS" ? moment.withoutNewsS : 0;
    const known = moment.last("vehicle") ?? {};
    const battery = moment.last("battery");
    const old = (fact) => (fact && (lost || silentS) ? `${told(moment.atS - Math.min(fact.at_s, lost?.since_s ?? Infinity) + silentS)} ago` : "");
    const heard = moment.isOver || moment.breaksOff || !story.opened ? null : moment.recent("fix", STALE_S);
    this.tiles.get("battery").showBattery(battery?.battery_percent, moment.stages, old(battery));
    this.tiles.get("link").show(lost ? `lost ${told(moment.atS - lost.since_s)}` : silentS ? "" : heard ? "ok" : "", { tone: lost ? "critical" : "" });
    const satellites = known.satellites === undefined ? "" : ` · ${known.satellites}`;
    const last = moment.last("fix"); // which comes with what the vehicle tells
    this.tiles.get("GPS").show(known.gps ? `${known.gps.replace("rtk-", "RTK ").replace("fixed", "fix")}${satellites}` : "", {
      tone: WEAK_FIXES.has(known.gps) ? "critical" : "",
      old: old(last),
    });
    this.tiles.get("mode").show(known.mode ?? "", { old: old(last) });
    this.tiles.get("motors").show({ true: "armed", false: "off" }[known.armed] ?? "", { old: old(last) });
  }
}

class Tile {
  constructor(name) {
    this.value = element("span");
    this.age = element("span");
    this.charge = drawn("rect", { x: 2.5, y: 3.5, height: 9, width: 0 });
    const outline = drawn("path", { d: "M1 2H23V14H1ZM23 5.5H26V10.5H23", fill: "none", stroke: "currentColor", "stroke-width": 2 });
    this.icon = drawn("svg", { viewBox: "0 0 27 16", width: 34, height: 20, "aria-hidden": "true" }, this.charge, outline);
    this.element = element("div", { hidden: "" }, element("dt", {}, name, this.age), element("dd", {}, this.value));
  }

  // With an age it is `old`, and told no more.
  show(words, { tone = "", old = "" } = {}) {
    this.element.hidden = !words;
    this.element.className = old ? "old" : tone;
    write(this.age, old && ` ${old}`);
    write(this.value, words);
  }

  showBattery(percent, stages, old) {
    this.show(percent === undefined ? "" : `${percent.toFixed(0)} %`, { tone: toneOfBattery(percent, stages), old });
    this.charge.setAttribute("width", (0.19 * Math.min(100, Math.max(0, percent ?? 0))).toFixed(1));
    if (!this.icon.parentNode) this.value.before(this.icon);
  }
}

// The colour of a battery at so many percent, by the vehicle's own stages if it told them.
export function toneOfBattery(percent, stages) {
  const low = stages?.low_percent ?? LOW_PERCENT;
  const critical = stages?.critical_percent ?? Math.min(CRITICAL_PERCENT, low);
  return percent < critical ? "critical" : percent < low ? "low" : "";
}

// A flight's state at its moment: in a word, with a tone that has a colour, and what it does.
export function stateOf(moment) {
  const { who = "WAITING", tone = "ground" } = moment.last("doing") ?? {};
  if (moment.withoutNewsS && !moment.silence) return { who: "NO NEWS", tone: "alarm", words: "" };
  if (moment.breaksOff) return { who: "LOG ENDS", tone: "torn", words: "" };
  return { who, tone, words: inWords(moment) };
}

// What the bar says of one flight, with what passes by itself and what stands in small letters.
function saysOf(moment) {
  const state = stateOf(moment);
  const { story } = moment;
  const words = moment.underWay?.doing || inWords(moment);
  const { who } = moment.last("doing") ?? {};
  if (state.who === "NO NEWS") {
    return { ...state, was: who, passing: `for ${told(moment.withoutNewsS)}`, small: [`last heard at ${story.timeOf(moment.atS)}: ${joined([who, words])}`] };
  }
  if (state.who === "LOG ENDS") {
    const where = moment.last("doing").tone === "ground" ? "on the ground" : "in the air";
    const ends = `at ${story.timeOf(story.endsS)} ${where} · last: ${who}`;
    return { ...state, words: ends, small: [words, ...beside(moment, state)], isLed: true };
  }
  const calling = callOf(moment);
  const small = beside(moment, state, calling);
  if (calling) return { ...state, words: calling.doing, passing: joined([courseOf(calling, moment)]), small, calls: true };
  return { ...state, passing: joined(figures(moment, state)), small };
}

// How many drones are in each state, in the colour of the worst.
function saysOfAll(moments) {
  const states = byTone(moments);
  const names = [...new Set(states.map(({ who }) => who))];
  const words = names.map((who) => `${states.filter((state) => state.who === who).length}\u00a0${who}`).join(" · ");
  return { tone: states[0].tone, who: `${moments.length} drones:`, words, isLed: true };
}

function byTone(moments) {
  return moments.map(stateOf).sort((one, other) => TONES.indexOf(one.tone) - TONES.indexOf(other.tone));
}

// The call that the drone waits for: none while it flies on, and no single one of several whose answers are open.
function callOf(moment) {
  const { open } = moment;
  return !open.length || (open.length === 1 && moment.stands) ? moment.underWay : null;
}

function joined(parts, between = " · ") {
  return unparted(parts.filter(Boolean).join(between));
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
  if (doing.tone === "ground" || moment.silence || moment.last("vehicle")?.armed === false) return [];
  const { position } = moment;
  const down = moment.isOver ? null : moment.recent("down", STALE_S);
  const battery = moment.last("battery")?.battery_percent;
  const isEmpty = doing.tone === "alarm" && battery < (moment.stages?.low_percent ?? LOW_PERCENT);
  const call = moment.stands && moment.open.length > 1 ? moment.underWay : null;
  return [
    position ? `${position.altitude_m.toFixed(0)} m` : "",
    down && doing.tone === "landing" ? `on the ground in ${told(down.down_s)}` : "",
    doing.tone === "program" && moment.open.length ? `${counted(moment.open.length, "answer")} open` : "",
    call ? `${call.doing}${courseOf(call, moment)}` : "",
    isEmpty ? `battery ${battery.toFixed(0)} %` : "",
  ];
}

// In small letters: when it is; since when another party has the vehicle; and of a flight of the program how far it is.
function beside(moment, doing, calling) {
  const { story } = moment;
  const atS = Math.min(moment.atS, story.ended?.at_s ?? Infinity); // beside a longer flight too
  const place = moment.position;
  const motion = moment.last("vehicle")?.armed === false ? null : moment.recent("motion", STALE_S);
  const others = doing.tone === "person" || doing.tone === "alarm";
  return [
    story.began ? story.timeOf(atS) : "",
    story.timeOfDay(atS),
    calling ? doing.words : "",
    others ? `since ${story.timeOf(moment.heldSince)}` : "",
    story.waypoints ? `${moment.reached} of ${counted(story.waypoints, "waypoint")} reached` : "",
    calling && place ? `${place.altitude_m.toFixed(0)} m` : "",
    motion?.ground_speed_m_s >= 0.05 && doing.tone !== "ground" ? `${motion.ground_speed_m_s.toFixed(1)} m/s` : "",
  ];
}
