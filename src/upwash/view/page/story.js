// What a log has told so far. Any moment of it is found by a search in lists that only grow.

import { told } from "./clock.js";
import { byName } from "./places.js";
import { Totals, countUntil } from "./totals.js";

const SERIES = ["fix", "battery", "motion", "link", "down", "vehicle", "doing", "notice", "decision", "call", "going", "turn", "measured", "answer", "shot", "told", "said", "open", "beside"];
export const STALE_S = 5; // a flight tells where it is every second: what it told longer ago says nothing about now
const MOST_SERVERS = 100; // that a page shows
const OVER_S = 3600; // without news, after which a flight is over, whatever its log says last
const USES = new Set(["ready", "checking"]); // the tones of servers that the drone uses or is about to
const MOVED_M = 0.5; // less may be the position's noise

export class Story {
  #listed; // the servers that the page shows, and of which
  #wanted = ({ review }) => review?.verdict !== "rejected"; // which findings a person wants to see

  constructor(name) {
    this.name = name;
    this.grows = true; // more can come
    this.zeroS = 0; // the second of the log at which the page's clock begins
    this.begin(0);
  }

  // Forgets everything: the log has begun another run.
  begin(run) {
    this.run = run;
    this.facts = 0;
    this.trouble = "";
    this.isBehind = false; // the log has told more than came so far
    this.plan = null;
    this.opened = null;
    this.began = null;
    this.firmware = null;
    this.forecast = null; // of when the mission is over, before it took off
    this.ended = null;
    this.lastS = 0;
    this.longestS = 0; // of the calls
    this.home = null;
    this.stages = null; // of the battery, as the vehicle has them
    this.arrivals = []; // when the first, the second, ... waypoint was reached
    this.steps = new Map();
    this.known = new Set(); // servers
    this.asked = new Set(); // of these, those that the drone wanted something of
    this.#listed = { servers: [], of: "" };
    this.operations = new Set();
    this.keepsPhotos = false;
    this.painted = []; // what photos show of the ground, by its corners
    this.courses = []; // which way, in degrees from north, the drone came to each fix; null before it moved
    this.moved = null; // the fix at which it had last moved
    this.delays = { place: new Totals(), operation: new Totals(), local: new Totals() }; // of the calls
    this.delaysAt = new Map(); // by place: those of its calls by operation
    this.found = { words: "", nouns: {}, numbers: [], objects: {}, reviews: {}, remarks: [] }; // in a sentence, by numbers, objects by their first sightings, reviews by number
    this.waits = new Totals();
    this.hidden = new Totals();
    this.others = []; // the same calls under other policies
    for (const kind of SERIES) this[kind] = [];
  }

  take(batch) {
    if (batch.run !== this.run) this.begin(batch.run);
    this.trouble = batch.trouble;
    this.isBehind = batch.more;
    for (const fact of batch.facts.slice(this.facts - batch.start)) this.#takeFact(fact);
  }

  // What was found has these numbers. The first sighting of an object has the place by all of them.
  number(found) {
    this.found = found;
    this.told.forEach((told, index) => {
      const { sightings, surest, best, ...place } = found.objects[index] ?? {};
      const no = found.numbers[index];
      const review = found.reviews[no];
      const noun = review?.label || found.nouns[told.what] || told.what;
      Object.assign(told, { index, no, noun, review, sightings, surest, best }, place);
    });
  }

  // The object of that number has this review from now on.
  review(no, review) {
    this.number({ ...this.found, reviews: { ...this.found.reviews, [no]: review } });
  }

  // From now on only these findings are shown.
  want(wanted) {
    this.#wanted = wanted;
    this.number({ ...this.found });
  }

  // The objects that were found, by their first sightings: those that come next get a number a moment later.
  get objects() {
    return this.told.filter(({ sightings }) => sightings !== undefined);
  }

  // Those of them that are shown.
  get numbered() {
    return this.objects.filter((finding) => this.shows(finding));
  }

  shows(finding) {
    return finding.no !== undefined && this.#wanted(finding);
  }

  #takeFact(fact) {
    this.facts += 1;
    this.lastS = fact.at_s;
    switch (fact.fact) {
      case "plan":
        this.plan = { ...fact, ranges: new Map(Object.entries(fact.ranges)) }; // a server may be called "constructor"
        for (const server of this.plan.ranges.keys()) this.known.add(server);
        break;
      case "opened":
      case "began":
      case "forecast":
      case "home":
      case "stages":
      case "firmware":
        this[fact.fact] = fact;
        if (fact.fact === "began") this.ended = null;
        break;
      case "ended":
        this.ended = fact;
        break;
      case "measured":
        this.known.add(fact.server);
        this.measured.push(fact);
        break;
      case "step":
        this.known.add(fact.server);
        this.asked.add(fact.server);
        if (!this.steps.has(fact.server)) this.steps.set(fact.server, []);
        this.steps.get(fact.server).push(fact);
        break;
      case "call":
        this.#takeCall(fact);
        break;
      case "started":
        this.#open(fact);
        break;
      case "amended":
        if (this.call[fact.number]) this.call[fact.number].words = fact.words;
        break;
      case "doing":
        while (this.arrivals.length < fact.reached) this.arrivals.push(fact);
        this.doing.push(fact);
        break;
      case "fix":
        if (fact.battery_percent !== undefined) this.battery.push(fact);
        if (fact.ground_speed_m_s !== undefined) this.motion.push(fact);
        if (fact.round_trip_s !== undefined) this.link.push(fact);
        if (fact.down_s !== undefined) this.down.push(fact);
        this.#takeCourse(fact);
        this.fix.push(fact);
        break;
      case "answer":
        this.hidden.add("", fact.at_s, fact.hidden_s ?? 0);
        this.#close(fact);
        this.answer.push(fact);
        break;
      case "shot":
        this.keepsPhotos ||= fact.kept;
        if (fact.footprint_m) this.painted.push(fact.footprint_m);
        this.shot.push(fact);
        break;
      default:
        this[fact.fact].push(fact);
    }
  }

  #takeCourse(fix) {
    this.moved ??= fix;
    const [east, north] = [fix.east_m - this.moved.east_m, fix.north_m - this.moved.north_m];
    const stays = Math.hypot(east, north) < MOVED_M;
    this.courses.push(stays ? (this.courses.at(-1) ?? null) : ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360);
    if (!stays) this.moved = fix;
  }

  // The waypoint's answer is there, or no more expected.
  #close({ waypoint, at_s }) {
    const open = this.open.findLast((each) => each.waypoint === waypoint);
    if (open?.until_s === Infinity) open.until_s = at_s;
  }

  #open(started) {
    const [east_m, north_m] = this.plan?.waypoints_m[started.waypoint] ?? [this.fix.at(-1)?.east_m, this.fix.at(-1)?.north_m];
    this.#close(started); // of a flight that was taken up again
    this.open.push({ ...started, until_s: Infinity, east_m, north_m });
  }

  #takeCall(call) {
    const { at_s, operation, place, delay_s, waited_s, queued_s = 0 } = call;
    this.longestS = Math.max(this.longestS, delay_s);
    this.operations.add(operation);
    this.delays.place.add(place, at_s, delay_s);
    this.delays.operation.add(operation, at_s, delay_s);
    if (!this.delaysAt.has(place)) this.delaysAt.set(place, new Totals());
    this.delaysAt.get(place).add(operation, at_s, delay_s);
    if (place === "local") this.delays.local.add(operation, at_s, delay_s - waited_s - queued_s);
    else {
      this.known.add(place);
      this.asked.add(place);
    }
    if (call.wait) this.waits.add("", at_s, waited_s);
    this.#close(call);
    this.call.push(call);
  }

  // Those that the page shows, the same array until they are others: of very many those that were asked for something.
  get servers() {
    const { asked, known } = this;
    const of = known.size > MOST_SERVERS ? `${known.size} ${asked.size}` : String(known.size);
    if (of !== this.#listed.of) {
      const shown = [...new Set([...asked, ...known])].slice(0, MOST_SERVERS);
      this.#listed = { servers: shown.sort(byName), of };
    }
    return this.#listed.servers;
  }

  // The plan with the ranges of these servers, the same until it is another one.
  get shownPlan() {
    const { plan, servers } = this;
    if (!plan || plan.ranges.size <= servers.length) return plan;
    if (this.#listed.plan?.of !== plan || this.#listed.plan.servers !== servers) {
      const ranges = new Map(servers.filter((name) => plan.ranges.has(name)).map((name) => [name, plan.ranges.get(name)]));
      this.#listed.plan = { ...plan, ranges, of: plan, servers };
    }
    return this.#listed.plan;
  }

  get waypoints() {
    return this.plan?.waypoints_m.length ?? 0;
  }

  // Whether the log is one that was written in flight, and does not say that the flight is over.
  get goesOn() {
    return Boolean(this.grows && this.opened && !this.ended) && this.silentS < OVER_S;
  }

  get breaksOff() {
    return Boolean(this.began && !this.ended && !this.goesOn && !this.isBehind && !this.trouble);
  }

  // How long ago the last of it was written.
  get silentS() {
    return Date.now() / 1000 - this.opened.epoch_s - (this.lastS - this.opened.at_s);
  }

  // The second of the log at which the story ends, as far as it is told.
  get endsS() {
    return this.ended?.at_s ?? this.lastS;
  }

  get isCompleted() {
    return Boolean(this.ended?.completed);
  }

  missionS(atS) {
    return atS - (this.began?.at_s ?? 0);
  }

  // A second of the log as people read it: of the mission, below 0 before it began, in brackets while it has not begun.
  timeOf(atS) {
    if (!this.began) return `[${told(atS)}]`;
    const missionS = this.missionS(atS);
    return missionS < 0 ? `−${told(Math.ceil(-missionS))}` : told(missionS);
  }

  // The time of day of a second of the log; empty where the log has none, as of a simulation.
  timeOfDay(atS) {
    if (!this.opened) return "";
    return new Date(1000 * (this.opened.epoch_s + atS - this.opened.at_s)).toTimeString().slice(0, 8);
  }

  clockS(atS) {
    return atS - this.zeroS;
  }

  at(clockS) {
    return new Moment(this, clockS + this.zeroS);
  }
}

// A moment of a story: how much of each list lies behind it, and what holds then.
class Moment {
  constructor(story, atS) {
    this.story = story;
    this.atS = atS;
  }

  count(kind) {
    return countUntil(this.story[kind], this.atS);
  }

  last(kind) {
    return this.story[kind][this.count(kind) - 1] ?? null;
  }

  // Where the call is now that is not over; null without one.
  get underWay() {
    const decision = this.isOver ? null : this.last("decision");
    return decision?.words && decision.number >= this.count("call") ? decision : null;
  }

  // The photos whose answers are not there.
  get open() {
    return this.story.open.slice(0, this.count("open")).filter(({ until_s }) => until_s > this.atS);
  }

  step(server) {
    const steps = this.story.steps.get(server) ?? [];
    return steps[countUntil(steps, this.atS) - 1] ?? null;
  }

  // The last of its kind, if it is not older than that.
  recent(kind, withinS) {
    const fact = this.last(kind);
    return fact && this.atS - fact.at_s <= withinS ? fact : null;
  }

  // How many waypoints are reached, and at which second of the mission the last of them was.
  get reached() {
    return countUntil(this.story.arrivals, this.atS);
  }

  get reachedAtS() {
    return this.story.missionS(this.story.arrivals[this.reached - 1].at_s);
  }

  // How much later than forecast it is, by the last waypoint or by the next one that it is not at yet; null if unknown.
  get lateS() {
    const { forecast, waypoints } = this.story;
    if (!forecast || !this.story.began || this.atS < this.story.began.at_s) return null;
    if (forecast.reached_s.length > waypoints) return null; // of another plan
    const nowS = this.story.missionS(this.isOver ? this.story.endsS : this.atS);
    if (this.isOver) return nowS - forecast.ends_s;
    const next = this.reached - (waypoints - forecast.reached_s.length); // it has the waypoints of a resumed flight only
    const overdueS = nowS - (forecast.reached_s[next] ?? forecast.ends_s);
    return next > 0 ? Math.max(this.reachedAtS - forecast.reached_s[next - 1], overdueS) : Math.max(0, overdueS);
  }

  // When it is expected to be over, in its own seconds; null if unknown.
  get expectedEndS() {
    if (this.lateS === null) return null;
    const { ends_s, lightest_s, finish_by_s } = this.story.forecast;
    const asAskedS = ends_s + this.lateS;
    const endS = finish_by_s === undefined ? asAskedS : Math.min(asAskedS, Math.max(finish_by_s, lightest_s));
    return Math.max(endS, this.story.missionS(this.atS));
  }

  // The servers that have failed so far.
  get failed() {
    const notices = this.story.notice.slice(0, this.count("notice"));
    const keys = notices.filter((notice) => notice.cause && notice.key.startsWith("server ")).map(({ key }) => key);
    return [...new Set(keys)].map((key) => key.slice("server ".length)).sort(byName);
  }

  // What a person has to act on or should know, the most urgent first.
  get notices() {
    const held = new Map();
    for (const notice of this.story.notice.slice(0, this.count("notice"))) {
      if (notice.cause) held.set(notice.key, notice);
      else held.delete(notice.key);
    }
    return [...held.values()].sort(byUrgency);
  }

  // That the vehicle is not heard; undefined while it is, or where nobody listens.
  get silence() {
    return this.notices.find(({ key }) => key === "link");
  }

  // As the vehicle told before the moment; null where it did not.
  get stages() {
    const { stages } = this.story;
    return stages && stages.at_s <= this.atS ? stages : null;
  }

  // Since when the one has the vehicle who has it.
  get heldSince() {
    const { doing } = this.story;
    let index = this.count("doing") - 1;
    while (index > 0 && doing[index - 1].who === doing[index].who) index -= 1;
    return doing[index].at_s;
  }

  // Whether the program flies the mission: it has not broken it off, and nobody has taken the vehicle.
  get isOnMission() {
    return this.last("doing")?.tone === "program";
  }

  // Whether nothing later is known.
  get isLatest() {
    return this.atS >= this.story.endsS - 1e-6;
  }

  // For how long the flight has told nothing, of which more should come; 0 while it tells.
  get withoutNewsS() {
    const silentS = this.isLatest && this.story.goesOn ? this.story.silentS : 0;
    return silentS > STALE_S ? silentS : 0;
  }

  // Whether the log has no more, though it does not say that the mission is over.
  get breaksOff() {
    return this.isLatest && this.story.breaksOff;
  }

  // Whether it is at a place for a call, and not on its way.
  get stands() {
    return Boolean(this.last("doing")?.stands);
  }

  get isOver() {
    return Boolean(this.story.ended && this.atS >= this.story.ended.at_s);
  }

  // The servers that the drone uses or is about to, those that are ready first.
  get using() {
    const steps = [...this.story.steps.keys()].map((server) => this.step(server)).filter((step) => step && USES.has(step.tone));
    steps.sort((one, other) => byName(one.server, other.server));
    return [...USES].flatMap((tone) => steps.filter((step) => step.tone === tone));
  }

  // The delays of the calls so far, by place.
  get delays() {
    return this.story.delays.place.until(this.atS);
  }

  // Of what ran on the drone so far without waiting, by operation.
  get localDelays() {
    return this.story.delays.local.until(this.atS);
  }

  // How many calls ran at each place so far, and how many of them waited.
  get calls() {
    const places = new Map([...this.delays].map(([place, { number }]) => [place, number]));
    return { count: this.count("call"), places, waited: this.story.waits.until(this.atS).get("")?.number ?? 0 };
  }

  // How much of the calls so far the mission did something else.
  get hiddenS() {
    return this.story.hidden.until(this.atS).get("")?.sum ?? 0;
  }

  // What offloading saved so far, at the mean local delays so far; null where an operation has not run on the drone, or
  // the drone has gone on before an answer was there.
  get savedS() {
    return this.#saved(this.story.delays.operation);
  }

  // What the calls at a place saved of that, calls that fell back to the drone not counted; null where it has none.
  savedAt(place) {
    const there = this.story.delaysAt.get(place);
    return there?.until(this.atS).size ? this.#saved(there) : null;
  }

  #saved(delays) {
    if (this.count("going")) return null;
    const local = this.localDelays;
    const all = [...delays.until(this.atS)];
    if (!all.every(([operation]) => local.has(operation))) return null;
    return all.reduce((saved, [operation, { sum, number }]) => saved + number * local.get(operation).mean - sum, 0);
  }

  // Where the drone is: on the straight way between two fixes.
  get position() {
    const fixes = this.story.fix;
    const count = this.count("fix");
    const [before, after] = [fixes[count - 1], fixes[count]];
    if (!before || !after) return before ?? after ?? null;
    const share = (this.atS - before.at_s) / (after.at_s - before.at_s);
    const between = (name) => before[name] + share * (after[name] - before[name]);
    return { east_m: between("east_m"), north_m: between("north_m"), altitude_m: between("altitude_m") };
  }

  // Which way its nose points, in degrees from north: as it told, or the way it moves; null where neither is known.
  get headingDeg() {
    const count = this.count("fix");
    const told = this.story.fix[count - 1]?.heading_deg;
    return told ?? this.story.courses[count] ?? this.story.courses[count - 1] ?? null;
  }
}

// The order of notices: what a person has to act on first, then by rank, then the newest.
export function byUrgency(one, other) {
  if (one.level !== other.level) return one.level === "alarm" ? -1 : 1;
  return one.rank - other.rank || other.at_s - one.at_s;
}
