// The call under way or the last one: where it is and since when, the sentence that says why, and what each place was
// expected to take; beside it the reasons in full, and what other policies did.

import { card, element, write } from "./element.js";
import { inBrief, nameOf, titleOf } from "./places.js";

const NAME = 16; // characters
const LEAST_S = 0.05; // of a wait that is worth a word
const OTHERS = "The same call under other policies:";

export class DecisionCard {
  #shown = null;

  constructor(places) {
    this.places = places;
    this.heading = element("h3");
    this.course = element("p", { class: "course" });
    this.cause = element("p", { class: "cause" });
    this.bars = element("dl", { class: "bars" });
    this.others = element("div", { class: "others" });
    this.reasons = element("ul", { class: "reasons" });
    this.element = element("section", { class: "card now" }, this.heading, this.course, this.cause, this.bars);
    this.why = card("Why there", this.reasons, this.others);
  }

  show(moment) {
    const decision = moment.underWay;
    const about = decision ?? moment.last("call");
    write(this.heading, headingOf(about, this.places, decision && (moment.withoutNewsS || moment.breaksOff ? "Call that was under way" : "Call under way")));
    write(this.course, decision ? wholeCourse(decision, moment) : about ? lineOf(about, moment.story) : "");
    const going = moment.last("going");
    const gone = decision && going && going.at_s >= decision.began_s && going.waypoint === decision.waypoint;
    const [cause = "", ...words] = about?.words ?? [];
    if (gone) words.push(`The drone goes on before the answer: ${going.words}.`);
    const { story } = moment;
    const shown = JSON.stringify([about?.at_s, cause, words, story.run, story.others.length]);
    if (shown === this.#shown) return;
    this.#shown = shown;
    write(this.cause, cause);
    this.#drawBars(about);
    this.others.replaceChildren(...(about ? othersOf(story, decision?.number ?? moment.count("call") - 1, this.places) : []));
    this.reasons.replaceChildren(...words.map((each) => element("li", {}, each)));
  }

  // A bar for each place that was considered, and for what the call took; the pale part is the wait.
  #drawBars(about) {
    const bars = (about?.estimates ?? []).map(({ place, wait_s, call_s }) => [place, inBrief(nameOf(place), NAME), wait_s ?? 0, call_s]);
    const { delay_s, waited_s, wait, place, queued_s = 0 } = about ?? {};
    if (bars.length && delay_s !== undefined) {
      const waitedS = queued_s + (wait ? waited_s : 0);
      bars.push([place, "it took", waitedS, Math.max(0, delay_s - waitedS)]);
    }
    const longestS = Math.max(0.1, ...bars.map(([, , waitS, callS]) => waitS + callS));
    this.bars.replaceChildren(...bars.flatMap((bar) => this.#bar(bar, longestS)));
  }

  #bar([place, name, waitS, callS], longestS) {
    const part = (seconds, style) => {
      const made = element("span", { class: style, "aria-hidden": "true" });
      made.style.width = `${(100 * seconds) / longestS}%`;
      return made;
    };
    const seconds = waitS >= LEAST_S ? `${waitS.toFixed(1)} + ${callS.toFixed(1)} s` : `${callS.toFixed(1)} s`;
    const style = this.places.style(place);
    const track = element("span", { class: `track ${style}` }, part(waitS, "waits"), part(callS, "calls"));
    return [element("dt", {}, name), element("dd", {}, track, element("span", { class: "seconds" }, seconds))];
  }
}

function headingOf(about, { operations }, underWay) {
  if (!about) return "No call was decided yet";
  const where = about.waypoint === null ? "before the first waypoint" : `at waypoint ${about.waypoint}`;
  return `${underWay ?? "Last call"}: ${titleOf(about.operation, operations)} ${where}`;
}

// For how long it is where it is, of how long at most or about: "3.1 of at most 3.9 s, also on the drone".
export function courseOf({ from_s, bound, limit_s, also_local }, moment) {
  const limit = limit_s === undefined ? "" : ` of ${bound} ${limit_s.toFixed(1)}`;
  return `, ${secondsSince(from_s, moment)}${limit} s${also_local ? ", also on the drone" : ""}`;
}

function secondsSince(atS, moment) {
  return Math.max(0, moment.atS - atS).toFixed(1);
}

function wholeCourse(decision, moment) {
  const photo = moment.open.find(({ waypoint }) => waypoint === decision.waypoint);
  if (photo) return `${decision.doing}${courseOf(decision, moment)}; photo at ${moment.story.timeOf(photo.at_s)}`;
  const begun = decision.from_s > decision.began_s;
  const since = begun ? `, ${secondsSince(decision.began_s, moment)} s since the call began` : "";
  return `${decision.doing}${courseOf(decision, moment)}${since}`;
}

// Of a call that others were open beside: when its photo was taken, how long it was in line, and when its answer came.
function lineOf({ waypoint, at_s, queued_s = 0 }, story) {
  const photo = story.open.find((each) => each.waypoint === waypoint && each.until_s === at_s);
  const inLine = queued_s >= LEAST_S ? `${queued_s.toFixed(1)} s in line, ` : "";
  return photo ? `photo at ${story.timeOf(photo.at_s)}, ${inLine}answer at ${story.timeOf(at_s)}` : "";
}

// Where the call of that number ran under other policies, and what it took.
function othersOf({ others }, number, places) {
  const known = others.filter(({ calls }) => calls[number]).map(({ name, calls }) => ({ name, ...calls[number] }));
  const items = known.map(({ name, place, delay_s }) =>
    element("li", {}, places.icon(place), ` ${name}: ${nameOf(place)}, ${delay_s.toFixed(1)} s`),
  );
  return items.length ? [element("p", {}, OTHERS), element("ul", {}, ...items)] : [];
}
