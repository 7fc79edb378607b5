// What a person has to act on, above everything else, and what a person should know: from when it begins to when it is over.

import { told } from "./clock.js";
import { element } from "./element.js";

const SILENT_S = 5; // a flight tells where it is every second

export class Banner {
  #shown = "";

  constructor(alarms, cautions) {
    this.alarms = alarms; // the element that is read out at once
    this.cautions = cautions;
  }

  // Of each flight at its moment; `live` says whether more can come. Returns how many alarms there are.
  show(moments, live) {
    const many = moments.length > 1;
    const held = moments.flatMap((moment) => noticesOf(moment, live).map((notice) => ({ ...notice, moment })));
    const lines = held.map((notice) => ({ ...notice, words: inWords(notice, many) }));
    const alarms = lines.filter((line) => line.level === "alarm");
    const key = JSON.stringify(lines.map((line) => [line.level, line.words]));
    if (key !== this.#shown) {
      this.#shown = key;
      fill(this.alarms, alarms);
      fill(this.cautions, lines.filter((line) => line.level !== "alarm"));
    }
    return alarms.length;
  }
}

// What holds at the moment, in the order in which it began.
function noticesOf(moment, live) {
  const silentS = live && moment.story.goesOn && moment.isLatest ? moment.story.silentS(Date.now() / 1000) : 0;
  if (silentS <= SILENT_S) return moment.notices;
  const cause = `No news of the flight for ${told(silentS)}`;
  return [...moment.notices, { level: "alarm", at_s: null, cause, action: "Look whether its program runs." }];
}

function inWords({ cause, action, at_s, moment }, many) {
  const name = many ? `${moment.story.name}: ` : "";
  const since = at_s === null ? "" : ` Since ${moment.story.timeOf(at_s)}.`;
  return [`${name}${cause}.`, `${action}${since}`.trim()];
}

function fill(where, lines) {
  where.hidden = lines.length === 0;
  where.replaceChildren(...lines.map(({ words: [cause, rest] }) => element("p", {}, element("strong", {}, cause), ` ${rest}`)));
}
