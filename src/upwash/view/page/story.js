// What a log has told so far. Any moment of it is found by a search in lists that only grow.

const SERIES = ["fix", "battery", "doing", "notice", "decision", "call", "going", "turn", "answer", "shot", "told", "said"];

export class Story {
  constructor(name) {
    this.name = name;
    this.zeroS = 0; // the second of the log at which the page's clock begins
    this.begin(0);
  }

  // Forgets everything: the log has begun another run.
  begin(run) {
    this.run = run;
    this.facts = 0;
    this.trouble = "";
    this.plan = null;
    this.opened = null;
    this.began = null;
    this.ended = null;
    this.lastS = 0;
    this.longestS = 0; // of the calls
    this.home = null;
    this.foreseen = null;
    this.reachedS = []; // when the first, the second, ... waypoint was reached
    this.steps = new Map();
    this.known = new Set(); // servers
    for (const kind of SERIES) this[kind] = [];
  }

  take(batch) {
    if (batch.run !== this.run) this.begin(batch.run);
    this.trouble = batch.trouble;
    for (const fact of batch.facts.slice(this.facts - batch.start)) this.#takeFact(fact);
  }

  #takeFact(fact) {
    this.facts += 1;
    this.lastS = fact.at_s;
    switch (fact.fact) {
      case "plan":
        this.plan = fact;
        for (const server of Object.keys(fact.ranges)) this.known.add(server);
        break;
      case "opened":
      case "began":
      case "home":
      case "foreseen":
        this[fact.fact] = fact;
        if (fact.fact === "began") this.ended = null;
        break;
      case "ended":
        this.ended = fact;
        break;
      case "step":
        this.known.add(fact.server);
        if (!this.steps.has(fact.server)) this.steps.set(fact.server, []);
        this.steps.get(fact.server).push(fact);
        break;
      case "call":
        this.longestS = Math.max(this.longestS, fact.delay_s);
        if (fact.place !== "local") this.known.add(fact.place);
        this.call.push(fact);
        break;
      case "doing":
        while (this.reachedS.length < fact.reached) this.reachedS.push(fact.at_s);
        this.doing.push(fact);
        break;
      case "fix":
        if (fact.battery_percent !== undefined) this.battery.push(fact);
        this.fix.push(fact);
        break;
      default:
        this[fact.fact].push(fact);
    }
  }

  get servers() {
    return [...this.known].sort();
  }

  get waypoints() {
    return this.plan?.waypoints_m.length ?? 0;
  }

  // Whether the log is one that was written in flight, and does not say that the flight is over.
  get goesOn() {
    return Boolean(this.opened && !this.ended);
  }

  // How long ago the last of it was written.
  silentS(epochS) {
    return epochS - this.opened.epoch_s - (this.lastS - this.opened.at_s);
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

  // A second of the log as people read it: of the mission, or in brackets of the log before the mission began.
  timeOf(atS) {
    if (this.began && atS >= this.began.at_s) return `${this.missionS(atS).toFixed(1)} s`;
    return `[${atS.toFixed(1)} s]`;
  }

  clockS(atS) {
    return atS - this.zeroS;
  }

  at(clockS) {
    return new Moment(this, clockS + this.zeroS);
  }
}

// A moment of a story: how much of each list lies behind it, and what holds then.
export class Moment {
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
    return countUntil(this.story.reachedS, this.atS, (atS) => atS);
  }

  get reachedAtS() {
    return this.story.missionS(this.story.reachedS[this.reached - 1]);
  }

  // What a person has to act on or should know, in the order in which it began.
  get notices() {
    const held = new Map();
    for (const notice of this.story.notice.slice(0, this.count("notice"))) {
      held.delete(notice.key);
      if (notice.cause) held.set(notice.key, notice);
    }
    return [...held.values()];
  }

  // Whether nothing later is known.
  get isLatest() {
    return this.atS >= this.story.endsS - 1e-6;
  }

  get isOver() {
    return Boolean(this.story.ended && this.atS >= this.story.ended.at_s);
  }

  // The servers that the drone uses or is about to, those that are ready first.
  get using() {
    const steps = this.story.servers.map((server) => this.step(server)).filter(Boolean);
    return ["ready", "checking"].flatMap((tone) => steps.filter((step) => step.tone === tone));
  }

  // How many calls ran at each place so far, and how many of them waited.
  get calls() {
    const places = new Map();
    let waited = 0;
    const count = this.count("call");
    for (let index = 0; index < count; index += 1) {
      const { place, wait } = this.story.call[index];
      places.set(place, (places.get(place) ?? 0) + 1);
      waited += wait ? 1 : 0;
    }
    return { count, places, waited };
  }

  // How much of the calls so far the mission did something else.
  get hiddenS() {
    return this.story.answer.slice(0, this.count("answer")).reduce((sum, { hidden_s }) => sum + hidden_s, 0);
  }

  // What offloading saved so far, at the mean local delays so far; null where an operation has not run on the drone, or
  // the drone has gone on before an answer was there.
  get savedS() {
    if (this.count("going")) return null;
    const calls = this.story.call.slice(0, this.count("call"));
    const local = new Map();
    for (const { operation, place, delay_s, waited_s } of calls) {
      if (place !== "local") continue;
      const [sum, number] = local.get(operation) ?? [0, 0];
      local.set(operation, [sum + delay_s - waited_s, number + 1]);
    }
    if (!calls.every(({ operation }) => local.has(operation))) return null;
    return calls.reduce((saved, { operation, delay_s }) => {
      const [sum, number] = local.get(operation);
      return saved + sum / number - delay_s;
    }, 0);
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
}

// How many of the facts, which are in the order of their time, lie at or before the moment.
export function countUntil(facts, atS, timeOf = (fact) => fact.at_s) {
  let [low, high] = [0, facts.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timeOf(facts[middle]) <= atS + 1e-6) low = middle + 1;
    else high = middle;
  }
  return low;
}
