// What a person has to act on, or should know: the most urgent of it alone, above everything else, and the rest by a click.

import { told } from "./clock.js";
import { element, write } from "./element.js";
import { byUrgency } from "./story.js";

export class Banner {
  constructor(alarms, cautions) {
    this.alarms = new Notice(alarms); // the element that is read out at once
    this.cautions = new Notice(cautions);
  }

  // Of each flight at its moment. Returns how many alarms there are.
  show(moments) {
    const many = moments.length > 1;
    const held = moments.flatMap((moment) => noticesOf(moment).map((notice) => ({ ...notice, moment })));
    const lines = held.sort(byUrgency).map((notice) => inWords(notice, many));
    const alarms = held.filter(({ level }) => level === "alarm").length;
    this.alarms.show(alarms ? lines : []);
    this.cautions.show(alarms ? [] : lines);
    return alarms;
  }
}

// One notice as far as the row has room, and all of it with the others behind "+2 more", which stays open or closed while they change.
class Notice {
  constructor(where) {
    this.where = where;
    this.first = element("p");
    this.count = element("summary");
    this.others = element("div");
    this.rest = element("details", { class: "rest" }, this.count, this.others);
    where.replaceChildren(this.first, this.rest);
  }

  show([first, ...others]) {
    this.where.hidden = !first;
    fill(this.first, first ?? ["", ""]);
    const isCut = !this.rest.open && this.first.scrollHeight > this.first.clientHeight + 1;
    this.rest.hidden = !others.length && !isCut && !this.rest.open;
    write(this.count, others.length ? `+${others.length} more` : "more");
    while (this.others.children.length > others.length) this.others.lastElementChild.remove();
    while (this.others.children.length < others.length) this.others.append(element("p"));
    others.forEach((line, index) => fill(this.others.children[index], line));
  }
}

// What holds at the moment.
function noticesOf(moment) {
  const { trouble } = moment.story; // why its log is read no further
  const told = trouble ? [{ level: "caution", rank: -1, at_s: 0, since_s: null, cause: trouble.replace(/\.$/, ""), action: "" }] : [];
  return [...whatHolds(moment), ...told];
}

function whatHolds(moment) {
  if (!moment.withoutNewsS) return moment.notices;
  const cause = `No news of the flight for ${told(moment.withoutNewsS)}`;
  const action = "Look whether its program runs.";
  return [{ level: "alarm", rank: -1, at_s: 0, since_s: null, cause, action }, ...moment.notices];
}

function inWords({ cause, action, since_s, times = 1, moment: { story } }, many) {
  const name = many ? `${story.name}: ` : "";
  const day = since_s === null ? "" : story.timeOfDay(since_s);
  const since = since_s === null ? "" : `Since ${story.timeOf(since_s)}${day ? ` (${day})` : ""}.`;
  return [`${name}${cause}${times > 1 ? ` ×${times}` : ""}.`, [action, since].filter(Boolean).join(" ")];
}

// Only where it changes, so that what is read out at once is read out once.
function fill(where, [cause, rest]) {
  if (where.textContent === `${cause} ${rest}`) return;
  where.replaceChildren(element("strong", {}, cause), ` ${rest}`);
}
