// The call under way or the last one: where it is and since when, the sentence that says why, and what each place was
// expected to take.

import { element, write } from "./element.js";
import { nameOf, theNameOf } from "./places.js";

export class DecisionCard {
  #shown = null;

  constructor(places) {
    this.places = places;
    this.heading = element("h3");
    this.course = element("p", { class: "course" });
    this.cause = element("p", { class: "cause" });
    this.bars = element("dl", { class: "bars" });
    this.reasons = element("ul", { class: "reasons" });
    this.element = element(
      "section", { class: "card now" }, this.heading, this.course, this.cause, this.bars, this.reasons,
    );
  }

  show(moment) {
    const decision = moment.underWay;
    const about = decision ?? moment.last("call");
    write(this.heading, headingOf(about, decision));
    write(this.course, decision ? courseOf(decision, moment) : "");
    const going = moment.last("going");
    const gone = decision && going && going.at_s >= decision.began_s && going.waypoint === decision.waypoint;
    const [cause = "", ...words] = about?.words ?? [];
    if (gone) words.push(`The drone goes on before the answer: ${going.words}.`);
    const shown = JSON.stringify([about?.at_s, cause, words]);
    if (shown === this.#shown) return;
    this.#shown = shown;
    write(this.cause, cause);
    this.#drawBars(about);
    this.reasons.replaceChildren(...words.map((each) => element("li", {}, each)));
  }

  // A bar for each place that was considered, and for what the call took; the pale part is the wait.
  #drawBars(about) {
    const bars = (about?.estimates ?? []).map(({ place, wait_s, call_s }) => [place, nameOf(place), wait_s ?? 0, call_s]);
    const { delay_s, waited_s, wait, place } = about ?? {};
    if (bars.length && delay_s !== undefined) {
      const waitedS = wait ? waited_s : 0;
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
    const seconds = waitS ? `${waitS.toFixed(1)} + ${callS.toFixed(1)} s` : `${callS.toFixed(1)} s`;
    const style = this.places.style(place);
    const track = element("span", { class: `track ${style}` }, part(waitS, "waits"), part(callS, "calls"));
    return [element("dt", {}, name), element("dd", {}, track, element("span", { class: "seconds" }, seconds))];
  }
}

function headingOf(about, decision) {
  if (!about) return "No call was decided yet";
  const where = about.waypoint === null ? "before the first waypoint" : `at waypoint ${about.waypoint}`;
  return `${decision ? "Call under way" : "Last call"}: ${about.operation} ${where}`;
}

// Where a call is, and the seconds so far of those that it may take at most.
export function courseOf(decision, moment) {
  const { place, waits, from_s, began_s, at_most_s, also_local } = decision;
  const since = (atS) => Math.max(0, moment.atS - atS).toFixed(1);
  const begun = from_s > began_s ? `, ${since(began_s)} s since the call began` : "";
  if (place !== "local") {
    const most = at_most_s === undefined || at_most_s === null ? "" : ` of at most ${at_most_s.toFixed(1)}`;
    const also = also_local ? ", also on the drone" : "";
    return `${waits ? "waiting for" : "on"} ${place}: ${since(from_s)}${most} s${also}${begun}`;
  }
  const expected = decision.estimates.find((estimate) => estimate.place === "local");
  return `on ${theNameOf(place)}: ${since(from_s)} s${expected ? `, ${expected.call_s.toFixed(1)} s expected` : ""}${begun}`;
}
