// The flight over time, which is the slider: lanes for the calls, the servers, alarms, battery and link.

import { told } from "./clock.js";
import { behindOver, inWords } from "./apart.js";
import { counted, line, write } from "./element.js";
import { inBrief, theNameOf, titleOf } from "./places.js";
import { guardWheel } from "./wheel.js";

const [WIDE, NARROW, RIGHT, AXIS] = [92, 62, 12, 18];
const NARROW_PX = 600;
const [LEAST, MOST, GAP] = [15, 24, 4]; // of a lane's height; and beneath each
const TALLER = 2; // times as high are lanes of calls, whose bars are as high as the calls were long
const THUMB_PX = 13;
const MARK = 4; // the radius of a place's mark
const STATES = { ready: "ready", checking: "check", trouble: "listed" }; // the colours of a server's states, by tone
const BESIDE = { detour: "on a detour to act on answers", wait: "waiting for answers" };
const NEAR_PX = 6; // of a call, to be pointed at
const ZOOM = 1.25; // with each step of a wheel
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400]; // between numbers on the axis
const SHORTEST_S = 5; // that fills all of it

export class Lanes {
  #drawn = ""; // what the lanes show
  #range = null; // the seconds from and to, where a person has zoomed
  #within = new Map(); // by server: when the drone was in its range, as far as the fixes were looked at
  #moment = null;
  lanes = [];

  // In that part of the page, over which the `slider` lies.
  constructor(frame, slider, places, changed) {
    Object.assign(this, { frame, slider, places, changed });
    [this.canvas, this.axis] = frame.querySelectorAll("canvas");
    this.tip = frame.querySelector(".tip");
    slider.addEventListener("pointermove", (event) => this.#point(event.offsetX - THUMB_PX / 2 + this.left, event.offsetY));
    slider.addEventListener("pointerleave", () => (this.tip.hidden = true));
    slider.addEventListener("wheel", (event) => this.#zoom(event), { passive: false });
    guardWheel(frame, "Turn the wheel with Ctrl to zoom");
    slider.addEventListener("dblclick", () => this.#showRange(null));
    new ResizeObserver(() => this.#moment && changed()).observe(frame);
  }

  // Draws anew what is shown next: the log has begun another run, or the colours are others.
  clear() {
    this.#drawn = "";
    this.#within.clear();
  }

  // The moment of the flight in focus; beside its calls those of the flights that it is held `against`, until `endS` of the page's clock.
  show(moment, against, endS) {
    const { story } = moment;
    if (this.#moment?.story !== story) this.clear();
    this.#moment = moment;
    this.endS = Math.max(1, endS);
    this.#follow(moment);
    const stories = against.length ? against.map((each) => each.story) : [story];
    const facts = stories.map((each) => `${each.run}-${each.facts}`);
    const what = [this.frame.clientWidth, this.frame.clientHeight, devicePixelRatio, ...facts, this.endS, this.#range].join();
    if (what !== this.#drawn) this.#draw(what, lanesOf(story, stories));
    const [from, to] = this.#span;
    const values = { min: from.toFixed(1), max: (this.#range ? to : endS).toFixed(1), value: story.clockS(moment.atS).toFixed(1) };
    for (const [name, value] of Object.entries(values)) if (this.slider[name] !== value) this.slider[name] = value;
    const words = `Calls, servers and alarms over time, ${story.name}. ${this.#inWords(moment)}`;
    if (words !== this.canvas.getAttribute("aria-label")) this.canvas.setAttribute("aria-label", words);
  }

  #inWords({ delays, calls }) {
    const words = [...delays].map(([place, { number, mean }]) => `${number} on ${theNameOf(place)}, ${mean.toFixed(2)} s on average`);
    return `${counted(calls.count, "call")}${words.length ? ": " + words.join("; ") : ""}.`;
  }

  // Where a person has zoomed, what is shown goes with the moment.
  #follow({ story, atS }) {
    const nowS = story.clockS(atS);
    const [from, to] = this.#range ?? [nowS, nowS];
    if (nowS < from || nowS > to) this.#range = this.#piece(nowS, to - from);
  }

  // So many seconds from that one on, as far as there are.
  #piece(fromS, lengthS) {
    const start = Math.min(Math.max(0, fromS), this.endS - lengthS);
    return [start, start + lengthS];
  }

  get #span() {
    return this.#range ?? [0, this.endS];
  }

  get left() {
    return this.width < NARROW_PX ? NARROW : WIDE;
  }

  #x(second) {
    const [from, to] = this.#span;
    return this.left + ((second - from) / (to - from)) * (this.width - this.left - RIGHT);
  }

  #second(x) {
    const [from, to] = this.#span;
    return Math.min(to, Math.max(from, from + ((x - this.left) / (this.width - this.left - RIGHT)) * (to - from)));
  }

  #zoom(event) {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    const [from, to] = this.#span;
    const here = this.#second(event.offsetX - THUMB_PX / 2 + this.left);
    const length = Math.max(SHORTEST_S, (to - from) * (event.deltaY > 0 ? ZOOM : 1 / ZOOM));
    this.#showRange(length < this.endS ? this.#piece(here - ((here - from) / (to - from)) * length, length) : null);
  }

  #showRange(range) {
    this.#range = range;
    this.changed();
  }

  #draw(what, lanes) {
    this.#drawn = what;
    this.width = this.frame.clientWidth;
    const parts = lanes.reduce((sum, { kind }) => sum + (kind === "calls" ? TALLER : 1), 0);
    const each = Math.min(MOST, Math.max(LEAST, Math.floor((this.frame.clientHeight - AXIS) / parts)));
    let top = 0;
    this.lanes = lanes.map((lane) => {
      const height = each * (lane.kind === "calls" ? TALLER : 1);
      top += height;
      return { ...lane, top: top - height, height: height - GAP };
    });
    this.height = Math.max(top, this.frame.clientHeight - AXIS);
    const sizes = [[this.canvas, this.height], [this.axis, AXIS]];
    for (const [canvas, height] of sizes) {
      canvas.width = Math.round(this.width * devicePixelRatio);
      canvas.height = Math.round(height * devicePixelRatio);
      Object.assign(canvas.style, { width: `${this.width}px`, height: `${height}px` });
      canvas.getContext("2d").setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    }
    Object.assign(this.slider.style, { left: `${this.left - THUMB_PX / 2}px`, width: `${this.width - this.left - RIGHT + THUMB_PX}px`, height: `${this.height}px` });
    const context = this.canvas.getContext("2d");
    this.#drawAxis(context);
    for (const lane of this.lanes) this.#drawName(context, lane);
    context.save();
    context.beginPath();
    context.rect(this.left, 0, this.width - this.left - RIGHT, this.height);
    context.clip();
    for (const lane of this.lanes) this.#drawLane(context, lane);
    context.restore();
  }

  #drawAxis(context) {
    const { colours } = this.places;
    const [from, to] = this.#span;
    const words = this.axis.getContext("2d");
    context.font = words.font = "12px system-ui, sans-serif";
    context.strokeStyle = colours.of("line");
    words.fillStyle = colours.of("soft");
    context.lineWidth = 1;
    words.textAlign = "center";
    const least = (70 * (to - from)) / this.width;
    const longest = STEPS_S.at(-1);
    const step = STEPS_S.find((each) => each >= least) ?? longest * Math.ceil(least / longest);
    for (let second = Math.ceil(from / step) * step; second <= to; second += step) {
      const x = Math.round(this.#x(second)) + 0.5;
      line(context, x, 0, x, this.height);
      words.fillText(told(second), Math.min(x, this.width - 16), 13);
    }
  }

  #drawName(context, { kind, name, top, height }) {
    const right = this.left - (kind === "server" ? 8 + 3 * MARK : 8);
    const middle = top + height / 2;
    context.fillStyle = this.places.colours.of("ink");
    context.textAlign = "right";
    let most = Math.min(name.length, this.left); // no letter is narrower than a pixel
    while (most > 3 && context.measureText(inBrief(name, most)).width > right) most -= 1;
    context.fillText(inBrief(name, most), right, middle + 4, right);
    if (kind === "server") this.places.paint(context, { place: name }, this.left - 8 - MARK, middle, MARK);
  }

  #drawLane(context, { kind, name, story, top, height }) {
    const { colours } = this.places;
    const bar = (fromS, toS, colour, alpha = 1, share = 1) => {
      context.globalAlpha = alpha;
      context.fillStyle = colour;
      const left = this.#x(story.clockS(fromS));
      context.fillRect(left, top + height * (1 - share), Math.max(1, this.#x(story.clockS(toS)) - left), height * share);
      context.globalAlpha = 1;
    };
    switch (kind) {
      case "calls":
        this.#drawCalls(context, bar, story, top, height);
        break;
      case "server":
        for (const [fromS, toS] of this.#inRange(story, name)) bar(fromS, toS, this.places.colour(name), 0.15);
        for (const [step, toS] of stretches(story.steps.get(name) ?? [], story.endsS)) {
          if (STATES[step.tone]) bar(step.at_s, toS, colours.of(STATES[step.tone]));
        }
        break;
      case "open": {
        const steps = openOver(story);
        const most = Math.max(...steps.map(({ number }) => number));
        for (const [{ at_s, number }, toS] of stretches(steps, story.endsS)) bar(at_s, toS, colours.of("soft"), 0.7, number / most);
        break;
      }
      case "detours":
        for (const [{ at_s, kind: what }, toS] of stretches(story.beside, story.endsS)) {
          if (what) bar(at_s, toS, colours.of(what === "wait" ? "check" : "ink"), 0.7);
        }
        break;
      case "alarms":
        for (const [notice, toS] of held(story)) bar(notice.at_s, toS, colours.of(notice.level === "alarm" ? "alarm" : "check"));
        break;
      default:
        this.#drawCurve(context, CURVES[kind](story, this.lanes), top, height);
    }
  }

  // Each call as broad as it lasted, as high as its delay, with the mark of its place on top where there is room; and the means on the drone.
  #drawCalls(context, bar, story, top, height) {
    const room = height - 2 * MARK;
    const longestS = this.lanes.reduce((most, lane) => Math.max(most, lane.story.longestS), 0.1);
    const [from, to] = this.#span;
    const inSight = (story.call.length * (to - from)) / Math.max(1, story.endsS);
    const hasMarks = inSight * 2.5 * MARK < this.width;
    for (const call of story.call) {
      const fromS = beganS(call);
      const share = Math.max(0.1, ((call.delay_s / longestS) * room) / height);
      bar(fromS, call.at_s, this.places.colour(call.place), 0.7, share);
      if (call.wait) bar(fromS, Math.min(call.at_s, fromS + call.waited_s), this.places.colours.of("ink"), 0.5, share);
      const x = (this.#x(story.clockS(fromS)) + this.#x(story.clockS(call.at_s))) / 2;
      if (hasMarks) this.places.paint(context, call, x, Math.max(top + MARK, top + height * (1 - share) - MARK + 2), MARK, 1);
    }
    context.strokeStyle = this.places.colours.of("place-0");
    context.lineWidth = 1.5;
    context.setLineDash([6, 4]);
    for (const { mean } of story.at(story.endsS).localDelays.values()) {
      const y = top + height - (mean / longestS) * room;
      line(context, this.left, y, this.width - RIGHT, y);
    }
    context.setLineDash([]);
  }

  #drawCurve(context, { facts, value, least = 0, most }, top, height) {
    context.strokeStyle = this.places.colours.of("ink");
    context.lineWidth = 1.4;
    context.beginPath();
    let last = -Infinity;
    for (const fact of facts) {
      const x = this.#x(this.#moment.story.clockS(fact.at_s));
      if (x - last < 1) continue;
      last = x;
      context.lineTo(x, top + height * (1 - (value(fact) - least) / (most - least)));
    }
    context.stroke();
  }

  // From when to when the drone was in the server's range, in seconds of the log.
  #inRange(story, server) {
    const range = story.plan?.ranges.get(server);
    if (!range) return [];
    const known = this.#within.get(server) ?? { seen: 0, found: [], since: null };
    this.#within.set(server, known);
    const [east, north, radius] = range;
    for (; known.seen < story.fix.length; known.seen += 1) {
      const fix = story.fix[known.seen];
      const inside = Math.hypot(fix.east_m - east, fix.north_m - north) <= radius;
      if (inside) known.since ??= fix.at_s;
      else if (known.since !== null) {
        known.found.push([known.since, fix.at_s]);
        known.since = null;
      }
    }
    return known.since === null ? known.found : [...known.found, [known.since, story.endsS]];
  }

  #point(x, y) {
    const lane = this.lanes.find(({ top, height }) => y >= top && y < top + height + GAP);
    const words = lane && x >= this.left ? this.#words(lane, this.#second(x), x) : "";
    this.tip.hidden = !words;
    write(this.tip, words);
    this.tip.style.left = `${Math.min(Math.max(x, 160), Math.max(160, this.width - 160))}px`;
  }

  #words({ kind, name, story }, second, x) {
    const there = story.at(second + story.zeroS);
    const at = `${told(second)} `;
    if (kind === "calls") {
      const call = story.call.find((each) => {
        const [left, right] = [beganS(each), each.at_s].map((atS) => this.#x(story.clockS(atS)));
        return x > left - NEAR_PX && x < right + NEAR_PX;
      });
      return call ? at + inShort(call, this.places.operations) : "";
    }
    if (kind === "open") {
      const { open } = there;
      const which = open.length ? `: ${open.length === 1 ? "waypoint" : "waypoints"} ${open.map(({ waypoint }) => waypoint).join(", ")}` : "";
      return `${at}${counted(open.length, "open answer")}${which}`;
    }
    if (kind === "detours") {
      const words = BESIDE[there.last("beside")?.kind];
      return words ? at + words : "";
    }
    if (kind === "server") {
      const step = there.step(name);
      const inside = this.#inRange(story, name).some(([fromS, toS]) => there.atS >= fromS && there.atS <= toS);
      const state = step ? [step.state, step.why].filter(Boolean).join(": ") : "available";
      return `${at}${name}${inside ? ", in range" : ""}: ${state}`;
    }
    if (kind === "alarms") {
      const causes = there.notices.map(({ cause }) => cause);
      return causes.length ? at + causes.join("; ") : "";
    }
    const { facts, value, words } = CURVES[kind](story, this.lanes);
    const last = facts.findLast((fact) => fact.at_s <= there.atS);
    return last ? `${at}${words(value(last))}` : "";
  }
}

const CURVES = {
  battery: (story) => ({ facts: story.battery, value: (fact) => fact.battery_percent, most: 100, words: (value) => `battery ${value.toFixed(0)} %` }),
  link: (story) => {
    const most = story.link.reduce((longest, fact) => Math.max(longest, 1000 * fact.round_trip_s), 1);
    return { facts: story.link, value: (fact) => 1000 * fact.round_trip_s, most, words: (value) => `link ${value.toFixed(0)} ms` };
  },
  behind: (story, lanes) => {
    const [first, second] = lanes.filter(({ kind }) => kind === "calls").map((lane) => lane.story);
    const facts = behindOver(first, second);
    const [least, most] = [Math.min(-1, ...facts.map(({ behind_s }) => behind_s)), Math.max(1, ...facts.map(({ behind_s }) => behind_s))];
    return { facts: facts.map((fact) => ({ ...fact, at_s: fact.clock_s + story.zeroS })), value: ({ behind_s }) => behind_s, least, most, words: (value) => inWords(value, first, second) };
  },
};

// What has a lane; what a log does not tell has none.
function lanesOf(story, stories) {
  const many = stories.length > 1;
  const calls = stories.map((each) => ({ kind: "calls", name: many ? each.name : "calls", story: each }));
  const servers = story.servers.map((name) => ({ kind: "server", name }));
  const others = [["open", story.open], ["detours", story.beside], ["alarms", story.notice], ["battery", story.battery], ["link", story.link]];
  const known = others.filter(([, facts]) => facts.length).map(([kind]) => ({ kind, name: kind }));
  const behind = stories.length === 2 ? [{ kind: "behind", name: "difference" }] : [];
  return [...calls, ...[...behind, ...servers, ...known].map((lane) => ({ ...lane, story }))];
}

function inShort(call, operations) {
  const where = call.waypoint === null ? "before the first waypoint" : `waypoint ${call.waypoint}`;
  const waited = call.wait ? `, ${call.waited_s.toFixed(2)} s of it waited` : "";
  const inLine = call.queued_s ? `, ${call.queued_s.toFixed(2)} s of it in line` : "";
  return `${where}: ${titleOf(call.operation, operations)} on ${theNameOf(call.place)}, ${call.delay_s.toFixed(2)} s${waited}${inLine}`;
}

// When it left the line.
function beganS({ at_s, delay_s, queued_s = 0 }) {
  return at_s - delay_s + queued_s;
}

// How many answers are open from each second on at which that changes.
function openOver(story) {
  const changes = story.open.flatMap(({ at_s, until_s }) => [[at_s, 1], [until_s, -1]]);
  let number = 0;
  return changes.filter(([atS]) => atS < Infinity).sort(([one], [other]) => one - other).map(([at_s, more]) => ({ at_s, number: (number += more) }));
}

// Each fact with the second at which the next one takes its place.
function stretches(facts, endsS) {
  return facts.map((fact, index) => [fact, facts[index + 1]?.at_s ?? endsS]);
}

// Each notice with the second at which its cause was over; cautions first, so that alarms lie above them.
function held(story) {
  const [open, found] = [new Map(), []];
  for (const notice of story.notice) {
    const before = open.get(notice.key);
    if (before) found.push([before, notice.at_s]);
    open.delete(notice.key);
    if (notice.cause) open.set(notice.key, notice);
  }
  for (const notice of open.values()) found.push([notice, story.endsS]);
  return found.sort(([one], [other]) => (one.level === "alarm") - (other.level === "alarm"));
}
